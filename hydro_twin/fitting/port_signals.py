"""What a residual owes to the signals at the ports, whatever the law: whether it is noise."""
from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import scipy

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.fit import Fit, project_out
from hydro_twin.fitting.output_error import initial_states
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import label
from hydro_twin.model import Model

BLOCK = 100             # samples, longer than the memory of noise
FOLDS = 5               # of the cross-validation, as is usual
SAME = 0.999            # correlation of two signals from which one of them is enough
MIN_BLOCKS = 10         # for the tests, two in a fold
RIDGES = (1e-5, 1e-3, 1e-1)     # of which the best is taken, and counted as three tries
LAGS = (0.005, 0.025)    # [s]
MIN_LAGS = (2.5, 12.5)  # samples: through less, what is sampled slowly passes unchanged
P_PREDICTED = 0.05      # p-value below which the port signals predict the residual
UNBOUNDED = 1e100       # of a column, whose squares would overflow
SMALL = 0.03            # singular value over the largest, below which a direction is left out


def predicted_by_ports(fit: Fit, parts: Sequence[Part]) -> tuple[float, float]:
    """Share of a residual that the port signals predict, in any way, and its p-value.

    The columns are the signals, their odd and even powers and their pairwise products, each
    unfiltered and through two lags: they detect structure even where no single curve does. They
    are taken one sample earlier, since a controller responds to the noise of a sample with the
    command of the same sample. Unknowns at a bound are not re-estimated either: the timing would
    let that command act at once. Noise, white or coloured, is not predicted.
    """
    fit, sample_time = fit.main, fit.candidate.sample_time
    observed = simulate_port_signals(fit.candidate, parts)
    joined = np.concatenate(observed)
    picked = _distinct(joined)
    largest = np.abs(joined[:, picked]).max(axis=0)
    pieces = []
    for part, seen in zip(parts, observed, strict=True):
        signals = seen[:, picked] / largest
        count = signals.shape[1]
        products = [signals[:, i] * signals[:, j] for i in range(count) for j in range(i)]
        shapes = np.column_stack([signals, np.abs(signals), signals * np.abs(signals),
                                  signals**3, *products])
        lagged = [shapes]
        for lag, least in zip(LAGS, MIN_LAGS, strict=True):
            share = 1.0 - np.exp(-1.0 / max(lag / sample_time, least))
            lagged.append(scipy.signal.lfilter([share], [1.0, share - 1.0], shapes, axis=0))
        pieces.append(part.whitened(np.column_stack(lagged))[fit.candidate.start_up - 1:-1])
    held = fit.at_bound()
    free = [label(unknown) not in held for unknown in fit.unknowns]
    basis, _ = np.linalg.qr(fit.jacobian[:, free])
    _, share, p_value = explained(np.concatenate(pieces), fit.residual, basis)
    return share, p_value


def _distinct(seen: FloatArray) -> list[int]:
    """Pick the columns that are not a multiple of one before."""
    picked: list[int] = []
    centred = seen - seen.mean(axis=0)
    size = np.linalg.norm(centred, axis=0)
    for k in range(seen.shape[1]):
        if size[k] > 0.0 and all(abs(centred[:, k] @ centred[:, j]) < SAME * size[k] * size[j]
                                 for j in picked):
            picked.append(k)
    return picked


def simulate_port_signals(candidate: Model, parts: Sequence[Part]) -> list[FloatArray]:
    """Run over parts and return what passes at ports and signals."""
    system, initial = candidate.system, initial_states(candidate, parts)
    all_seen = []
    for part, x, z in zip(parts, initial.x, initial.z, strict=True):
        seen = np.zeros((len(part.inputs), system.step.sensors))
        system.run(part.inputs, x, z, seen, part.start)
        all_seen.append(np.nan_to_num(seen))
    return all_seen


def explained(columns: FloatArray, residual: FloatArray, basis: FloatArray
              ) -> tuple[FloatArray, float, float]:
    """Regress a residual on columns, both less what re-estimated parameters could do (the basis).

    The share of the residual's power is cross-validated: each fifth of the blocks is predicted by
    the others, so that more columns do not explain more by themselves. The p-value is that of
    the gain being above zero over the blocks, by Student's test of its mean or by
    Wilcoxon's of its ranks, which holds for coloured noise as long as the blocks are longer than
    its memory.

    Args:
        columns: (N, d).
        residual: (N,).
        basis: orthonormal, (N, b).

    Returns:
        weights of the columns (d,), share, p-value.
    """
    # What is carried by laws that are not stable grows without bound, and explains nothing.
    columns = np.where(np.abs(columns).max(axis=0, initial=0.0) < UNBOUNDED, columns, 0.0)
    columns = project_out(columns, basis)
    residual = project_out(residual, basis)
    size = np.linalg.norm(columns, axis=0)
    size[size <= 1e-9 * size.max(initial=0.0)] = np.inf
    X = columns / size
    squares, V = np.linalg.eigh(X.T @ X)
    kept = squares > SMALL**2 * squares.max(initial=0.0)
    if not kept.any():
        return np.zeros(columns.shape[1]), 0.0, 1.0
    V, squares = V[:, kept], squares[kept]
    weights = V @ (V.T @ (X.T @ residual) / squares) / size
    scores = X @ V / np.sqrt(squares[-1])
    count = max(MIN_BLOCKS, len(residual) // BLOCK)
    gains = max(_gains(scores, residual, count), key=np.sum)
    power = float(residual @ residual)
    if power <= 0.0 or np.ptp(gains) <= 0.0:
        return weights, 0.0, 1.0
    tests = (scipy.stats.ttest_1samp(gains, 0.0, alternative='greater'),
             scipy.stats.wilcoxon(gains, alternative='greater'))
    return weights, float(gains.sum()) / power, min(1.0, 2.0 * len(RIDGES) * min(
        float(test.pvalue) for test in tests))


def _gains(scores: FloatArray, residual: FloatArray, count: int) -> FloatArray:
    """Return what each of `count` blocks loses of its power by what the other folds predict.

    With each of the ridges, (`RIDGES`, count).
    """
    edges = np.linspace(0, len(residual), count + 1).astype(int)
    blocks = [slice(a, b) for a, b in pairwise(edges)]
    grams = np.array([scores[b].T @ scores[b] for b in blocks])
    crosses = np.array([scores[b].T @ residual[b] for b in blocks])
    ridges = np.array(RIDGES)[:, None, None] * np.eye(scores.shape[1])
    gains = np.empty((len(RIDGES), count))
    for fold in range(FOLDS):
        out = np.arange(count) % FOLDS == fold
        found = np.linalg.solve(grams[~out].sum(axis=0) + ridges, crosses[~out].sum(axis=0))
        for k in np.flatnonzero(out):
            r = residual[blocks[k]]
            gains[:, k] = r @ r - np.sum((r[:, None] - scores[blocks[k]] @ found.T)**2, axis=0)
    return gains
