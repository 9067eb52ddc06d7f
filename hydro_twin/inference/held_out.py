"""The improvement on held-out data, with an interval by block bootstrap."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import fitted_residuals
from hydro_twin.fitting.parts import Part
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.result import Improvement

BLOCK = 50              # samples, longer than the correlation of the residuals
# Most blocks: as many determine an interval well enough. Of a longer recording the blocks are
# longer, and so allow for errors that change slowly, as those of a rig at 1 kHz do.
BLOCKS = 50
DRAWS = 2000            # of the bootstrap: 20 beyond each limit of the interval
LIMITS = 0.01, 0.99     # of the interval: an improvement is above zero at the level of 1 %


def improvement(before: Sequence[FloatArray], after: Sequence[FloatArray], seed: int
                ) -> Improvement:
    """Compare two sets of residuals on the same samples by their mean squares.

    Blocks of samples are drawn with replacement, both residuals together, so that the interval
    allows for their autocorrelation and their correlation [Kuensch 1989]. A run that diverged
    counts as an error of `LIMIT` from there on.
    """
    return _interval(*_relative(before, after, seed))


def p_of_no_gain(before: Sequence[FloatArray], after: Sequence[FloatArray], seed: int) -> float:
    """Return the probability that the mean square error became no smaller."""
    _, drawn = _relative(before, after, seed)
    return float(np.mean(drawn <= 0.0))


def _relative(before: Sequence[FloatArray], after: Sequence[FloatArray], seed: int
              ) -> tuple[float, FloatArray]:
    """Return by how much the mean square became smaller, in all and as drawn."""
    a, b, _ = _blocks(before, after)
    drawn = _draws(len(a), seed)
    relative = 1.0 - b[drawn].sum(axis=1) / np.maximum(a[drawn].sum(axis=1), 1e-300)
    return float(1.0 - b.sum() / max(a.sum(), 1e-300)), relative


def geometric_improvement(before: Sequence[FloatArray], after: Sequence[FloatArray], seed: int
                          ) -> Improvement:
    """Compare two sets of residuals as `improvement`, by the geometric mean over the blocks.

    A mean square is that of its worst blocks: where something else happens in one of eight
    windows, as to a rig under manual control, it says nothing of the others. The median of those
    after is added to all, so that blocks in which hardly anything happens count little.
    """
    a, b, samples = _blocks(before, after)
    least = np.median(b / samples)
    gains = samples * np.log(np.maximum((a / samples + least) / np.maximum(
        b / samples + least, 1e-300), 1e-300))
    drawn = _draws(len(a), seed)
    relative = 1.0 - np.exp(-gains[drawn].sum(axis=1) / samples[drawn].sum(axis=1))
    return _interval(float(1.0 - np.exp(-gains.sum() / samples.sum())), relative)


def surer_improvement(before: Sequence[FloatArray], after: Sequence[FloatArray], seed: int
                      ) -> Improvement:
    """Return the one of the two that is surer: each sees what the other may not.

    Mean squares see what happens seldom and much, as a stop that is met; their geometric mean
    what happens throughout.
    """
    both = [compare(before, after, seed) for compare in (improvement, geometric_improvement)]
    return max(both, key=lambda one: one.low)


def _blocks(before: Sequence[FloatArray], after: Sequence[FloatArray]
            ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum the squares of both residuals block by block; returns also how many samples each has."""
    block = max(BLOCK, sum(map(len, before)) // BLOCKS)
    sums = np.array([
        (np.sum(a[begin:begin + block] ** 2), np.sum(b[begin:begin + block] ** 2),
         len(a[begin:begin + block]))
        for a, b in zip(map(_bounded, before), map(_bounded, after), strict=True)
        for begin in range(0, len(a), block)])
    return sums[:, 0], sums[:, 1], sums[:, 2]


def _draws(blocks: int, seed: int) -> IntArray:
    """Draw blocks with replacement, (DRAWS, blocks)."""
    return np.random.default_rng(seed).integers(0, blocks, (DRAWS, blocks))


def _interval(relative: float, drawn: FloatArray) -> Improvement:
    low, high = np.quantile(drawn, LIMITS)
    return Improvement(relative, float(low), float(high))


def _bounded(error: FloatArray) -> FloatArray:
    bounded: FloatArray = np.clip(np.nan_to_num(error, nan=LIMIT), -LIMIT, LIMIT)
    return bounded


def residuals(fit: Fit, held_out: Sequence[Part]) -> list[FloatArray]:
    """Return the residuals of held-out parts, their initial states fitted to all of each part.

    Where a plant integrates, the error of an initial state estimated from the first samples may be
    most of the residual. It says nothing of the laws.
    """
    return fitted_residuals(fit.candidate, held_out)


def held_out_gain(before: Fit, after: Fit, held_out: Sequence[Part], seed: int) -> Improvement:
    """Compare the residuals of two fits on held-out parts."""
    return surer_improvement(residuals(before, held_out), residuals(after, held_out), seed)
