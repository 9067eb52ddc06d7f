"""How fits to the same data compare: BIC and likelihood ratio, where samples have memory."""
from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from scipy.special import chdtrc

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.autoregression import (
    autoregression,
    effective_gain,
    effective_samples,
    whiten,
)
from hydro_twin.fitting.fit import Fit
from hydro_twin.predictors.scores import rms

CLEAR_DELTA_BIC = 10.0  # difference of the BIC from which one law is preferred to another


def delta_bic(fits: Sequence[Fit], free: Sequence[int] | None = None) -> list[float]:
    """BIC of fits to the same parts over that of the best, which has 0.

    The best is the one of the lowest BIC with the effective number of samples. Another is as far
    from it as that says, or the BIC of residuals whitened by the filter of the best, whichever is
    larger: beside an offset few samples count as independent, and laws still differ in what is
    fast.

    Args:
        fits: to the same parts.
        free: how many unknowns of each are not at a bound; None: as the fit itself says.
    """
    free = [fit.free for fit in fits] if free is None else free
    best = min(fits, key=lambda fit: fit.cost)
    counts = [effective_samples(pieces) for pieces in best.by_output]
    filters = [autoregression(pieces) for pieces in best.by_output]
    effective = [_bic(fit, d, [np.concatenate(pieces) for pieces in fit.by_output], counts)
                 for fit, d in zip(fits, free, strict=True)]
    first = int(np.argmin(effective))
    white = []
    for fit, d in zip(fits, free, strict=True):
        rows = [whiten(*some) for some in zip(fit.by_output, filters, strict=True)]
        white.append(_bic(fit, d, rows, [len(row) for row in rows]))
    return [max(e - effective[first], w - white[first])
            for e, w in zip(effective, white, strict=True)]


def _bic(fit: Fit, d: int, rows: Sequence[FloatArray], samples: Sequence[float]) -> float:
    """Return N ln(S/n) + d ln N, the first summed over the output and the sensors.

    S is the sum of squares of n samples, with what leaving the usual values costs.

    Args:
        fit: to judge.
        d: how many of its unknowns are not at a bound.
        rows: its residual of each.
        samples: N, how many count as independent, of each.
    """
    penalised = 1.0 + fit.penalty / max(float(fit.residual @ fit.residual), 1e-300)
    return d * math.log(sum(samples)) + sum(
        n * math.log(max(penalised * rms(row)**2, 1e-300))
        for n, row in zip(samples, rows, strict=True) if len(row))


def gain_p_value(before: Fit, after: Fit, tried: int) -> float:
    """Likelihood-ratio tests of what the last effect adds, times the number of effects tried.

    There are two tests, and the smaller p-value counts, doubled. That with the effective number of
    samples detects an effect that removes most of a slow error. That with whitened residuals
    detects one that is masked by a slow error of another cause, such as an offset.
    """
    added = max(1, after.fitted - before.fitted)
    return min(1.0, 2 * tried * float(chdtrc(added, max(_gain(before, after), 0.0))))


def refinement_gain(simple: Fit, refined: Fit) -> float:
    """Return the reduction of the BIC by a refinement, from the larger of the same two gains.

    It is -inf if the refinement does not lower the cost.
    """
    if not refined.cost < simple.cost:
        return -math.inf
    added = refined.fitted - simple.fitted
    return _gain(simple, refined) - added * math.log(len(refined.residual))


def _gain(before: Fit, after: Fit) -> float:
    """Return the larger gain, each summed over output and sensors."""
    pairs = list(zip(before.by_output, after.by_output, strict=True))
    return max(sum(gain(*pair) for pair in pairs) for gain in (effective_gain, whitened_gain))


def whitened_gain(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Twice the gain of the log-likelihood, residuals whitened by the filter of the latter."""
    filter_ = autoregression(after)
    a, b = (whiten(pieces, filter_) for pieces in (before, after))
    return len(a) * math.log(max(float(a @ a), 1e-300) / max(float(b @ b), 1e-300))
