"""The fit of physical parameters to the one-step error, on its triangular factor alone."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from scipy.optimize import least_squares as bounded_least_squares

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.regression import Regression, regressors
from hydro_twin.plants import Plant
from hydro_twin.recording.series import Series

# (P, d) physical parameters -> (P, m) coefficients of the difference equation; takes complex ones
Coefficients = Callable[[npt.NDArray[Any]], npt.NDArray[Any]]
Objective = Callable[[FloatArray], FloatArray]      # (P, d) candidates -> (P,) errors

SCREENED, STARTS = 1024, 12    # points of the box that are compared (a power of two, as Sobol's
#                         sequence asks), and those that a search starts from
COMPLEX_STEP = 1e-30
PRECISION = 1e-12       # of the squared error: far below what a population could still gain
AT_BOUND = 1e-3         # of the logarithmic width of the box: a search may stop this near an edge
PIECE = 65536           # rows judged at once: longer than any memory of the residual


@dataclass(frozen=True)
class SearchResult:
    """The best candidate of a search.

    Attributes:
        best: shape (d,).
        error: its error.
        history: the learning curve: the least error so far after each start or cycle, shape
            (starts,) or (cycles,).
    """

    best: FloatArray
    error: float
    history: FloatArray


def one_step_error(regression: Regression, coefficients: Coefficients) -> Objective:
    """Return the function that scores a population of physical parameters by its rms, eq. 5."""
    return lambda population: regression.rms(coefficients(population))


def embedding(
    names: Sequence[str], combinations: Sequence[Mapping[str, int]],
    lower: FloatArray, upper: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Lay coordinates over the box, one for each quantity that the data can determine.

    A coordinate x in [0, 1] moves one parameter over its range, on a logarithmic scale, or all
    parameters of one combination at once, so that the combination covers its whole range:
    log p = origin + M x.

    Args:
        names: of the d parameters.
        combinations: groups that act only together, as in `Plant.combinations`.
        lower: lower corner of the box, above zero, shape (d,).
        upper: upper corner.

    Returns:
        origin, shape (d,), and M, shape (d, coordinates).
    """
    sign = np.ones(len(names))
    group = np.arange(len(names))
    for combination in combinations:
        members = [names.index(name) for name in combination]
        sign[members] = np.sign(list(combination.values()))
        group[members] = members[0]
    width = np.log(upper) - np.log(lower)
    M = (sign * width)[:, None] * (group[:, None] == np.unique(group))
    return np.where(sign > 0.0, np.log(lower), np.log(upper)), M


def derivative(coefficients: Coefficients, parameters: FloatArray) -> FloatArray:
    """Differentiate the coefficients by the logarithm of each parameter, by the complex step.

    Exact to rounding: nothing is subtracted.

    Args:
        coefficients: the difference equation.
        parameters: shape (d,).

    Returns:
        Shape (m, d).
    """
    moved = parameters + 1j * COMPLEX_STEP * np.diag(parameters)
    slope: FloatArray = coefficients(moved).imag.T / COMPLEX_STEP
    return slope


def least_squares(
    regression: Regression, coefficients: Coefficients, names: Sequence[str],
    combinations: Sequence[Mapping[str, int]], lower: FloatArray, upper: FloatArray, seed: int,
    starts: int = STARTS,
) -> SearchResult:
    """Minimise the one-step error over the box, from many starts.

    Each start is a bounded least-squares problem of m residuals, the rows of the factor, with
    exact derivatives; the starts are the best of a Sobol sequence.

    Args:
        regression: the factor of the samples.
        coefficients: the difference equation.
        names: of the d parameters.
        combinations: groups that act only together.
        lower: lower corner of the box, above zero, shape (d,).
        upper: upper corner.
        seed: the same seed gives the same result.
        starts: how many of the sequence are searched from.

    Returns:
        The best of all starts; the history has one entry a start. Members of a combination
        that the data do not distinguish have the same relative position in their ranges.
    """
    origin, M = embedding(names, combinations, lower, upper)
    X, y = regression.R[:, :-1], regression.R[:, -1]
    objective = one_step_error(regression, coefficients)

    def parameters(x: FloatArray) -> FloatArray:
        return np.clip(np.exp(origin + x @ M.T), lower, upper)  # exp may miss a corner by an ulp

    def residual(x: FloatArray) -> FloatArray:
        c: FloatArray = coefficients(parameters(x)[None])[0]
        return X @ c - y

    def jacobian(x: FloatArray) -> FloatArray:
        slope: FloatArray = derivative(coefficients, parameters(x)) @ M
        return X @ slope

    drawn = scipy.stats.qmc.Sobol(M.shape[1], rng=seed).random(SCREENED)
    begun = drawn[np.argsort(objective(parameters(drawn)), kind='stable')[:starts]]
    ends = np.array([
        bounded_least_squares(residual, x, jacobian, bounds=(0.0, 1.0), ftol=PRECISION,
                              xtol=PRECISION, gtol=PRECISION).x for x in begun])
    found = parameters(ends)
    errors = objective(found)
    best = int(np.argmin(errors))
    return SearchResult(found[best], float(errors[best]), np.minimum.accumulate(errors))


def at_bound(
    names: Sequence[str], parameters: FloatArray, lower: FloatArray, upper: FloatArray,
) -> tuple[str, ...]:
    """Name the parameters that stopped at the edge of the box."""
    height = np.log(parameters / lower) / np.log(upper / lower)
    return tuple(name for name, h in zip(names, height, strict=True)
                 if min(h, 1.0 - h) < AT_BOUND)


def sensitivities(
    stretches: Iterable[Series], output: str, inputs: Sequence[str], order: int,
    coefficients: Coefficients, parameters: FloatArray,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the Jacobian and the residual of the one-step error, for `assess`, piece by piece.

    Yields:
        d y / d log(parameters), shape (N, d), and y - x c, shape (N,).
    """
    c = coefficients(parameters[None])[0]
    slope = derivative(coefficients, parameters)
    for series in stretches:
        for rows in regressors(series, output, inputs, order, PIECE):
            yield rows[:, :-1] @ slope, rows[:, -1] - rows[:, :-1] @ c


def box(plant: Plant) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper corner of the search box, each of shape (d,)."""
    lower, upper = np.array([(p.lower, p.upper) for p in plant.parameters]).T
    return lower, upper


def search_least_squares(factor: Regression, coefficients: Coefficients, plant: Plant, seed: int,
                         starts: int = STARTS) -> SearchResult:
    """Search the plant's box for the least one-step error; see `least_squares`."""
    return least_squares(factor, coefficients, [p.name for p in plant.parameters],
                         plant.combinations, *box(plant), seed, starts)
