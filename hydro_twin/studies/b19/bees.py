"""BA of [B19]: the Bees Algorithm, local search at the best sites, random scouts."""
from __future__ import annotations

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.one_step import Objective, SearchResult
from hydro_twin.studies.b19.scorer import CYCLES, INDIVIDUALS, Scorer

ELITE_SITES, SITES = 2, 6               # ne, nb
ELITE_FORAGERS, FORAGERS = 20, 10       # nre, nrb
STAGNATION_LIMIT = 10
PATCH = 0.5                             # widths of the box either side of a new site
SHRINK = 0.8                            # of a patch on which no forager finds better

FORAGERS_OF_RANK = np.repeat((ELITE_FORAGERS, FORAGERS), (ELITE_SITES, SITES - ELITE_SITES))
SITE_OF_FORAGER = np.repeat(np.arange(SITES), FORAGERS_OF_RANK)
FIRST_FORAGER = np.cumsum(FORAGERS_OF_RANK) - FORAGERS_OF_RANK
SCOUTS = INDIVIDUALS - SITE_OF_FORAGER.size


def bees(
    objective: Objective, lower: FloatArray, upper: FloatArray, seed: int,
    first_patch: float = PATCH, shrink: float = SHRINK,
) -> SearchResult:
    """Send out 100 bees a cycle for 100 cycles, with the settings of [B19] Table 2.

    Of each cycle's 100 candidates 80 search the patches round the six best sites and 20 scout
    the whole box. A patch, whose size the paper leaves open, is a box of half the search box's
    width either side to begin with, and shrinks by 0.8 whenever no forager improves its site
    (Pham and Castellani 2009); after ten such cycles in a row the site is abandoned, and only the
    record keeps it.

    Args:
        objective: scores a population, shape (P, d) -> (P,).
        lower: lower corner of the box, shape (d,).
        upper: upper corner.
        seed: the same seed gives the same result.
        first_patch: widths of the box either side of a new site.
        shrink: factor of a patch on which no forager finds better.
    """
    rng = np.random.default_rng(seed)
    score = Scorer(objective)
    d = lower.size
    scouts = rng.uniform(lower, upper, (INDIVIDUALS, d))
    errors = score(scouts)
    best = np.argsort(errors, kind='stable')[:SITES]
    sites, site_errors = scouts[best], errors[best]
    patch, stagnation = np.ones(SITES), np.zeros(SITES, int)
    for _ in range(CYCLES - 1):
        reach = first_patch * patch[SITE_OF_FORAGER, None] * (upper - lower)
        spread = reach * rng.uniform(-1.0, 1.0, (SITE_OF_FORAGER.size, d))
        foragers = np.clip(sites[SITE_OF_FORAGER] + spread, lower, upper)
        scouts = rng.uniform(lower, upper, (SCOUTS, d))
        errors = score(np.concatenate((foragers, scouts)))

        for site, begin in enumerate(FIRST_FORAGER):
            leader = begin + np.argmin(errors[begin:begin + FORAGERS_OF_RANK[site]])
            if errors[leader] < site_errors[site]:
                sites[site], site_errors[site] = foragers[leader], errors[leader]
                stagnation[site] = 0
            else:
                patch[site] *= shrink
                stagnation[site] += 1
        site_errors[stagnation >= STAGNATION_LIMIT] = np.inf    # abandoned: any scout is better

        everything = np.concatenate((site_errors, errors[foragers.shape[0]:]))
        kept = np.argsort(everything, kind='stable')[:SITES]
        sites, site_errors = np.concatenate((sites, scouts))[kept], everything[kept]
        patch = np.concatenate((patch, np.ones(SCOUTS)))[kept]
        stagnation = np.concatenate((stagnation, np.zeros(SCOUTS, int)))[kept]
    return score.result()
