"""Proof on data that was not fitted: the improvement, with an interval by blocks."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import fitted_residuals
from hydro_twin.fitting.parts import Part
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.result import Improvement

BLOCK = 50              # samples, longer than the memory of the plants' errors
# Most blocks: as many determine an interval well enough. Of a longer recording the blocks are
# longer, and so allow for errors that change slowly, as those of a rig at 1 kHz do.
BLOCKS = 50
DRAWS = 2000


def improvement(before: Sequence[FloatArray], after: Sequence[FloatArray], seed: int
                ) -> Improvement:
    """Compare two sets of residuals on the same samples, stretch by stretch.

    Blocks of samples are drawn with replacement, both residuals together, so that the interval
    allows for their memory and for their likeness [Kuensch 1989]. A run that diverged counts as
    an error of `LIMIT` from there on.
    """
    pairs, block = [], max(BLOCK, sum(map(len, before)) // BLOCKS)
    for a, b in zip(map(_bounded, before), map(_bounded, after), strict=True):
        for begin in range(0, len(a), block):
            pairs.append((float(np.sum(a[begin:begin + block] ** 2)),
                          float(np.sum(b[begin:begin + block] ** 2))))
    sums = np.array(pairs)
    rng = np.random.default_rng(seed)
    drawn = sums[rng.integers(0, len(sums), (DRAWS, len(sums)))].sum(axis=1)
    low, high = np.quantile(1.0 - drawn[:, 1] / np.maximum(drawn[:, 0], 1e-300), [0.01, 0.99])
    total = sums.sum(axis=0)
    return Improvement(float(1.0 - total[1] / max(total[0], 1e-300)), float(low), float(high))


def _bounded(error: FloatArray) -> FloatArray:
    bounded: FloatArray = np.clip(np.nan_to_num(error, nan=LIMIT), -LIMIT, LIMIT)
    return bounded


def residuals(fit: Fit, held_out: Sequence[Part]) -> list[FloatArray]:
    """Return what is missed of parts that were not fitted, but for what their starts missed.

    Where a plant integrates, the error of a start that 50 samples show may be most of what is
    missed later. It says nothing of the laws.
    """
    return fitted_residuals(fit.candidate, held_out)


def proof(before: Fit, after: Fit, held_out: Sequence[Part], seed: int) -> Improvement:
    """Compare what the laws of two fits leave on parts that neither was fitted to."""
    return improvement(residuals(before, held_out), residuals(after, held_out), seed)
