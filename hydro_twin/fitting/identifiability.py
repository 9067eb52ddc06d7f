"""What the data determine, with standard errors that allow for coloured residuals."""
from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.regression import triangle
from hydro_twin.plants.combinations import product_of_powers

NULL = 1e-8             # singular values below this share of the largest are rounding
UNKNOWN = 1.0           # a relative standard error above this says no more than the box did
NULL_WEIGHT = 0.01      # a parameter with more weight in the null space gets no standard error


@dataclass(frozen=True)
class Identifiability:
    """What a fit can claim to know.

    Standard errors are in the scale of the Jacobian: relative for logarithmic parameters.

    Attributes:
        std_error: parameter -> standard error; None where the data do not determine it by itself.
        combinations: parameters that act only together, e.g. 'V_m/beta_e' -> the standard error
            of their product of powers, or None.
        at_bound: parameters that stopped at the edge of their box; the other standard errors
            hold for these as they are.
        coordinates: what the rows of the covariance stand for.
        covariance: of the coordinates, shape (len(coordinates),) * 2.
        factor: square root of the information matrix, (k, coordinates); directions without effect
            are in none of its rows. With d, what is added to the coordinates of the fit,
            |factor d - step|^2 is twice the negative log-likelihood, up to a constant.
        step: factor times the Gauss-Newton step that is left, (k,); zero where the search ended
            at the least sum of squares.
    """

    std_error: Mapping[str, float | None]
    combinations: Mapping[str, float | None]
    at_bound: tuple[str, ...]
    coordinates: tuple[str, ...]
    covariance: FloatArray
    factor: FloatArray
    step: FloatArray


def assess(
    stretches: Iterable[tuple[FloatArray, FloatArray]], names: Sequence[str],
    combinations: Sequence[Mapping[str, int]] = (), at_bound: Collection[str] = (),
) -> Identifiability:
    """Judge a least-squares fit from its Jacobian and its residual.

    The covariance is the sandwich A^-1 S A^-1 with A = J'J and S the long-run covariance of the
    scores J(k) r(k) (Newey and West 1987, Bartlett weights), so that a residual with memory or
    of changing size is allowed for. It says how far the estimate scatters, not how far a wrong
    model is off.

    Args:
        stretches: (Jacobian, shape (N, d); residual, shape (N,)) of uninterrupted stretches,
            the Jacobian by the logarithm of each parameter, or by the parameter over its scale.
        names: of the d parameters.
        combinations: groups known to act only together, as in `Plant.combinations`; their
            members must be logarithmic.
        at_bound: parameters to be held where they are.
    """
    labels, picked = _coordinates(names, combinations, at_bound)
    scores = np.zeros((len(labels), len(labels)))               # S = scores' scores
    gradient = np.zeros(len(labels))                            # J'r
    samples = 0

    def blocks() -> Iterable[FloatArray]:
        nonlocal samples
        for jacobian, residual in stretches:
            columns = jacobian @ picked
            samples += residual.size
            gradient[:] += columns.T @ residual
            scores[...] = triangle((scores, _score_windows(columns, residual)))
            yield columns

    R = triangle(blocks()) if labels else np.zeros((0, 0))
    _, singular, Vt = np.linalg.svd(R)
    known = singular > NULL * singular.max(initial=0.0)
    W = Vt[known].T / singular[known]                           # (J'J)^+ = W W'
    freedom = samples / max(samples - len(labels), 1)
    root = W @ (W.T @ scores.T) * np.sqrt(freedom)              # covariance = root root'
    error = np.linalg.norm(root, axis=1)
    blind = np.linalg.norm(Vt[~known], axis=0) > NULL_WEIGHT
    errors = {label: float(e) if e <= UNKNOWN and not hidden else None
              for label, e, hidden in zip(labels, error, blind, strict=True)}
    groups = [product_of_powers(combination.items()) for combination in combinations]
    factor = _information(Vt[known], root)
    return Identifiability(
        std_error={name: errors.get(name) for name in names},
        combinations={group: errors.get(group) for group in groups},
        at_bound=tuple(name for name in names if name in at_bound),
        coordinates=tuple(labels),
        covariance=root @ root.T,
        factor=factor,
        step=factor @ W @ (W.T @ gradient),
    )


def _information(V: FloatArray, root: FloatArray) -> FloatArray:
    """Invert the covariance root root' within the directions V, (k, d); returns a factor, (k, d).

    A fit without any scatter has none: its rows would be infinite.
    """
    T = triangle(((V @ root).T,)) if V.size else V
    if not np.diagonal(T).all():
        return np.zeros((0, V.shape[1]))
    factor: FloatArray = solve_triangular(T, V, trans='T') if V.size else V
    return factor


def _coordinates(
    names: Sequence[str], combinations: Sequence[Mapping[str, int]], at_bound: Collection[str],
) -> tuple[list[str], FloatArray]:
    """Name the free coordinates, and map them to parameters, shape (d, coordinates).

    A combination moves by one member that is free: the rest of it may be left where it is.
    """
    together = {name: combination for combination in combinations for name in combination}
    labels: list[str] = []
    columns = []
    for i, name in enumerate(names):
        power = together.get(name, {}).get(name, 1)
        label = product_of_powers(together[name].items()) if name in together else name
        if name not in at_bound and label not in labels:
            labels.append(label)
            columns.append(np.eye(len(names))[i] / power)
    return labels, np.array(columns).reshape(len(labels), len(names)).T


def _score_windows(jacobian: FloatArray, residual: FloatArray) -> FloatArray:
    """Sum the scores J(k) r(k) over a sliding window, shape (N + width, d).

    Their square is the sum of the covariances of the scores over all lags, with falling
    (Bartlett) weights. The width is Andrews' (1991) for an autoregressive residual of order one,
    up to a fifth of the samples.
    """
    n = residual.size
    power = residual @ residual
    rho = residual[1:] @ residual[:-1] / power if power > 0.0 else 0.0
    memory = 4.0 * rho**2 / max((1.0 - rho**2)**2, 1e-12)
    width = int(np.clip(np.ceil(1.1447 * (memory * n)**(1 / 3)), 1, max(n // 5, 1)))
    scores = np.pad(jacobian * residual[:, None], ((width, width), (0, 0)))
    total = np.cumsum(scores, axis=0)
    windows: FloatArray = (total[width:] - total[:-width]) / np.sqrt(width)
    return windows
