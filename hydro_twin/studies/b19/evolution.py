"""EA of [B19]: mutation with step sizes that evolve themselves, and no crossover."""
from __future__ import annotations

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.one_step import Objective, SearchResult
from hydro_twin.studies.b19.scorer import CYCLES, INDIVIDUALS, Scorer

STEP = 0.1          # K_i in widths of the box


def evolution(
    objective: Objective, lower: FloatArray, upper: FloatArray, seed: int,
    power: float = 2.0, sigmas: str = 'gene',
) -> SearchResult:
    """Breed 100 generations of 100, with the settings of [B19] Table 2.

    Roulette-wheel selection, generational replacement, elitism of one, mutation rate 1:
    gene + K_i N(0, sigma_i). Three things the paper leaves open: an individual's slot on the
    wheel is a power of its inverse error; every gene has a sigma_i of its own; and sigma_i, which
    starts at 1, mutates by the usual log-normal factor (Baeck and Schwefel 1993). Genes are
    clamped to the box.

    Args:
        objective: scores a population, shape (P, d) -> (P,).
        lower: lower corner of the box, shape (d,).
        upper: upper corner.
        seed: the same seed gives the same result.
        power: of the inverse error, for the wheel.
        sigmas: one for each 'gene', or one for each 'individual'.
    """
    rng = np.random.default_rng(seed)
    score = Scorer(objective)
    shape = INDIVIDUALS, lower.size
    own, common = 1.0 / np.sqrt(2.0 * np.sqrt(lower.size)), 1.0 / np.sqrt(2.0 * lower.size)
    genes, sigma = rng.uniform(lower, upper, shape), np.ones(shape)
    errors = score(genes)
    for _ in range(CYCLES - 1):
        parents = rng.choice(INDIVIDUALS, INDIVIDUALS, p=_wheel(errors, power))
        parents[0] = np.argmin(errors)
        elite, elite_sigma = genes[parents[0]], sigma[parents[0]]
        drift = common * rng.standard_normal((INDIVIDUALS, 1))
        if sigmas == 'gene':
            drift = drift + own * rng.standard_normal(shape)
        sigma = sigma[parents] * np.exp(drift)
        step = STEP * (upper - lower) * sigma * rng.standard_normal(shape)
        genes = np.clip(genes[parents] + step, lower, upper)
        genes[0], sigma[0] = elite, elite_sigma
        errors = score(genes)
    return score.result()


def _wheel(errors: FloatArray, power: float) -> FloatArray:
    """Share of the roulette wheel that each individual gets, summing to 1."""
    if not np.isfinite(errors).any():
        return np.full(errors.size, 1.0 / errors.size)
    positive = np.maximum(errors, np.finfo(float).tiny)
    slots = (positive.min() / positive) ** power                # relative: 1 / tiny^2 overflows
    share: FloatArray = slots / slots.sum()
    return share
