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
    """BIC of fits to the same parts, with the effective number of samples of the best.

    N ln(S/n) + d ln N, with S the sum of squares of n samples, N the number of independent ones
    that say as much, and d the number of unknowns that are not at a bound; the first summed over
    the output and the sensors.
    """
    best = min(fits, key=lambda fit: fit.cost)
    counts = [effective_samples(pieces) for pieces in best.by_output]
    values = []
    for fit in fits:
        pulled = 1.0 + fit.pulled / max(float(fit.residual @ fit.residual), 1e-300)
        free = len(fit.unknowns) - len(fit.at_bound())
        powers = [rms(np.concatenate(pieces))**2 for pieces in fit.by_output]
        values.append(sum(count * math.log(max(pulled * power, 1e-300))
                          for count, power in zip(counts, powers, strict=True))
                      + free * math.log(sum(counts)))
    return values


def gain_p_value(before: Fit, after: Fit, tried: int) -> float:
    """Likelihood-ratio tests of what the last effect adds, times the number of effects tried.

    Two, of which the smaller p-value counts, twice. By independent samples, which sees what takes
    off most of an error that changes slowly; and of whitened residuals, which sees past a slow
    error that something else is the reason of, as an offset.
    """
    pairs = list(zip(before.by_output, after.by_output, strict=True))
    ratio = max(sum(gain(*pair) for pair in pairs) for gain in (slow_gain, whitened_gain))
    added = max(1, len(after.unknowns) - len(before.unknowns))
    log_p = float(stats.chi2.logsf(max(ratio, 0.0), added)) + math.log(2 * tried)
    return min(1.0, math.exp(max(log_p, -700.0)))


def slow_gain(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Twice the gain of the log-likelihood, with the effective number of samples of the latter."""
    a, b = (rms(np.concatenate(pieces))**2 for pieces in (before, after))
    return effective_samples(after) * math.log(max(a, 1e-300) / max(b, 1e-300))


def whitened_gain(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Twice the gain of the log-likelihood, residuals whitened by the filter of the latter."""
    filter_ = autoregression(after)
    a, b = (whiten(pieces, filter_) for pieces in (before, after))
    return len(a) * math.log(max(float(a @ a), 1e-300) / max(float(b @ b), 1e-300))
