"""How far each rig of a group is from the others, parameter by parameter.

Every rig i has an estimate y_i with a standard error s_i. The true values scatter about a mean mu
with a standard deviation tau:

    y_i ~ N(theta_i, s_i^2),    theta_i ~ N(mu, tau^2)

This is the random-effects model of meta-analysis: R. DerSimonian, N. Laird, Meta-analysis in
clinical trials, Controlled Clinical Trials 7 (1986) 177-188. tau^2 is estimated by restricted
maximum likelihood: W. Viechtbauer, Bias and efficiency of meta-analytic variance estimators in
the random-effects model, J. Educ. Behav. Stat. 30 (2005) 261-293. The scores are the deleted
residuals of W. Viechtbauer, M. W.-L. Cheung, Outlier and influence diagnostics for meta-analysis,
Res. Synth. Methods 1 (2010) 112-125.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student

from hydro_twin.arrays import FloatArray

BoolArray = npt.NDArray[np.bool_]

CHANCE = 0.05           # of a score that stands out though its rig is as the others
MOST = 20               # rigs that are left out of a group, and at most a quarter of it
ITERATIONS = 1000
TOLERANCE = 1e-10       # of tau^2, relative to the variance of the estimates
ROWS = 256              # that are left out at once: as much memory as a thousand rigs take


class Scores(NamedTuple):
    """Where each of n rigs stands.

    Attributes:
        scores: (n,), deviation of each rig from the others, which do not know it, over the
            standard deviation of that deviation; nan for fewer than three rigs.
        kept: (n,), which rigs do not stand out.
    """

    scores: FloatArray
    kept: BoolArray


def compare_each(y: FloatArray, s: FloatArray) -> Scores:
    """Score the estimates of a group.

    A rig that stands out would widen the spread for all others. The farthest is left out as long
    as its score is beyond `limit`.

    Args:
        y: (n,), estimates, n >= 1.
        s: (n,), their standard errors, above zero.
    """
    n = len(y)
    v = s ** 2
    kept = np.ones(n, dtype=bool)
    while True:
        scores = _scores(y, v, kept)
        inside = np.where(kept, np.abs(scores), 0.0)
        farthest = int(np.argmax(inside))
        if (kept.sum() <= 3 or n - kept.sum() >= min(MOST, n // 4)
                or inside[farthest] < limit(n, int(kept.sum()))):
            return Scores(scores, kept)
        kept[farthest] = False


def limit(comparisons: int, rigs: int) -> float:
    """Say which score stands out: of so many comparisons, one does by chance once in twenty times.

    The spread of a small group is known from few rigs, which Student's distribution allows for.
    """
    return float(student.isf(CHANCE / (2 * comparisons), max(rigs - 2, 1)))


def _scores(y: FloatArray, v: FloatArray, kept: BoolArray) -> FloatArray:
    """Score each rig against those that are kept, without itself; nan where these are too few."""
    n = len(y)
    scores = np.full(n, np.nan)
    if n < 3:
        return scores
    for begin in range(0, n, ROWS):
        rows = np.arange(begin, min(begin + ROWS, n))
        others = np.tile(kept * 1.0, (len(rows), 1))
        others[np.arange(len(rows)), rows] = 0.0
        tau2, mean, var = _fit(y, v, others)
        scores[rows] = (y[rows] - mean) / np.sqrt(v[rows] + tau2 + var)
    return scores


def _fit(y: FloatArray, v: FloatArray, kept: FloatArray
         ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Estimate (tau^2, mu, variance of mu), (k,) each, for k choices of what is kept, (k, n).

    From the estimate of DerSimonian and Laird the restricted likelihood is climbed by the
    iteration tau^2 = sum w^2 ((y - mu)^2 - v) / sum w^2 + 1 / sum w, which is its root.
    """
    w = kept / v
    total = w.sum(axis=1)
    mean = (w @ y) / total
    q = (w * (y - mean[:, None]) ** 2).sum(axis=1)
    free = total - (w ** 2).sum(axis=1) / total
    tau2 = np.maximum(0.0, (q - (kept.sum(axis=1) - 1.0)) / np.where(free > 0.0, free, np.inf))
    scale = max(float(np.var(y)), float(np.min(v)))
    for _ in range(ITERATIONS):
        w = kept / (v + tau2[:, None])
        total = w.sum(axis=1)
        mean = (w @ y) / total
        square = w ** 2
        after = np.maximum(0.0, (square * ((y - mean[:, None]) ** 2 - v)).sum(axis=1)
                           / square.sum(axis=1) + 1.0 / total)
        after[kept.sum(axis=1) < 2] = 0.0
        step = np.abs(after - tau2).max()
        tau2 = after
        if step <= TOLERANCE * scale:
            break
    w = kept / (v + tau2[:, None])
    total = w.sum(axis=1)
    return tau2, (w @ y) / total, 1.0 / total


def surprise(having: int, others: int) -> float:
    """Score how unusual it is that a rig has something that `having` of its `others` have.

    The chance of it is (having + 1/2) / (others + 1), the mean of a beta distribution with the
    prior of Jeffreys; the score is the quantile of the normal distribution that is exceeded with
    this chance, so that it may stand beside deviations.
    """
    return float(norm.isf((having + 0.5) / (others + 1.0)))
