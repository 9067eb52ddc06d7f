"""How fits to the same data compare: BIC and likelihood ratio, where samples have memory."""
from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from scipy import stats

from hydro_twin.fitting.autoregression import autoregression, effective_samples, whiten
from hydro_twin.fitting.fit import Fit
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms

CLEARLY = 10.0          # difference of the BIC from which one law is preferred to another


def criterion(fits: Sequence[Fit]) -> list[float]:
    """BIC of fits to the same parts over that of the best, which has 0.

    N ln(S/n) + d ln N, with S the sum of squares of n samples, N the number of independent ones,
    as the best leaves them, and d the number of unknowns that are not at a bound; the first summed
    over the output and the sensors. By this the best is found. Another is as far from it as that
    says, or the BIC of whitened residuals, whichever distinguishes them better: beside an offset
    few samples count as independent, and the laws still differ in what is fast.
    """
    best = min(fits, key=lambda fit: fit.cost)
    counts = [effective_samples(pieces) for pieces in best.by_output]
    filters = [autoregression(pieces) for pieces in best.by_output]
    slow, white = [0.0] * len(fits), [0.0] * len(fits)
    for k, fit in enumerate(fits):
        free = len(fit.unknowns) - len(fit.at_bound())
        pulled = 1.0 + fit.pulled / max(float(fit.residual @ fit.residual), 1e-300)
        whites = [whiten(*some) for some in zip(fit.by_output, filters, strict=True)]
        for scores, rows, samples in (
                (slow, [np.concatenate(pieces) for pieces in fit.by_output], counts),
                (white, whites, [float(len(row)) for row in whites])):
            scores[k] = free * math.log(sum(samples)) + sum(
                n * math.log(max(pulled * rms(row)**2, 1e-300))
                for n, row in zip(samples, rows, strict=True) if len(row))
    b = int(np.argmin(slow))
    return [0.0 if k == b else max(slow[k] - slow[b], white[k] - white[b])
            for k in range(len(fits))]


def gain_p_value(before: Fit, after: Fit, tried: int) -> float:
    """Likelihood-ratio tests of what the last effect adds, times the number of effects tried.

    Two, of which the smaller p-value counts, twice. By independent samples, which sees what takes
    off most of an error that changes slowly; and of whitened residuals, which sees past a slow
    error that something else is the reason of, as an offset.
    """
    added = max(1, len(after.unknowns) - len(before.unknowns))
    log_p = float(stats.chi2.logsf(max(_gain(before, after), 0.0), added)) + math.log(2 * tried)
    return min(1.0, math.exp(max(log_p, -700.0)))


def refinement_gain(simple: Fit, refined: Fit) -> float:
    """BIC that a refinement of a law takes off, by the larger of the same two gains.

    Less than nothing, if it does not lower what the fits minimise.
    """
    if not refined.cost < simple.cost:
        return -math.inf
    added = len(refined.unknowns) - len(simple.unknowns)
    return _gain(simple, refined) - added * math.log(len(refined.residual))


def _gain(before: Fit, after: Fit) -> float:
    """Return the larger gain, each summed over output and sensors."""
    pairs = list(zip(before.by_output, after.by_output, strict=True))
    return max(sum(gain(*pair) for pair in pairs) for gain in (slow_gain, whitened_gain))


def slow_gain(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Twice the gain of the log-likelihood, with the effective number of samples of the latter."""
    a, b = (rms(np.concatenate(pieces))**2 for pieces in (before, after))
    return effective_samples(after) * math.log(max(a, 1e-300) / max(b, 1e-300))


def whitened_gain(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Twice the gain of the log-likelihood, residuals whitened by the filter of the latter."""
    filter_ = autoregression(after)
    a, b = (whiten(pieces, filter_) for pieces in (before, after))
    return len(a) * math.log(max(float(a @ a), 1e-300) / max(float(b @ b), 1e-300))
