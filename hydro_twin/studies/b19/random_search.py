"""RG of [B19]: uniform draws from the box, of which the best is kept."""
from __future__ import annotations

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.one_step import Objective, SearchResult
from hydro_twin.studies.b19.scorer import CYCLES, INDIVIDUALS, Scorer


def random_search(
    objective: Objective, lower: FloatArray, upper: FloatArray, seed: int,
) -> SearchResult:
    """Draw 100 x 100 candidates.

    Args:
        objective: scores a population, shape (P, d) -> (P,).
        lower: lower corner of the box, shape (d,).
        upper: upper corner.
        seed: the same seed gives the same result.
    """
    rng = np.random.default_rng(seed)
    score = Scorer(objective)
    for _ in range(CYCLES):
        score(rng.uniform(lower, upper, (INDIVIDUALS, lower.size)))
    return score.result()
