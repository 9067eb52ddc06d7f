"""Whether a residual is white: the portmanteau test of Ljung and Box."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from hydro_twin.arrays import FloatArray

LAGS = 25
CONFIDENCE = 0.99


def is_white(stretches: Sequence[FloatArray]) -> bool:
    """Ljung-Box test over 25 lags at 99 %, each stretch by itself, together by their sum."""
    statistic, freedom = 0.0, 0
    for r in stretches:
        n = len(r)
        centred = r - r.mean()
        power = centred @ centred
        if n <= 2 * LAGS or power <= 0.0:
            continue
        rho = np.array([centred[lag:] @ centred[:n - lag] for lag in range(1, LAGS + 1)]) / power
        statistic += n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, LAGS + 1))))
        freedom += LAGS
    return freedom == 0 or bool(statistic < scipy.stats.chi2.ppf(CONFIDENCE, freedom))
