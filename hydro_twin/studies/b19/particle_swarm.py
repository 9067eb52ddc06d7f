"""PSO of [B19]: a fully connected particle swarm, kept inside the box."""
from __future__ import annotations

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.one_step import Objective, SearchResult
from hydro_twin.studies.b19.scorer import CYCLES, INDIVIDUALS, Scorer

ALPHA, BETA, GAMMA = 1.0, 2.0, 2.0      # inertia, pull to the own best, pull to the swarm's
SPEED_LIMIT = 0.1                       # widths of the box in one cycle


def particle_swarm(
    objective: Objective, lower: FloatArray, upper: FloatArray, seed: int,
    speed_limit: float = SPEED_LIMIT,
) -> SearchResult:
    """Move 100 particles for 100 cycles, with the settings of [B19] Table 2.

    With these weights a swarm is at the edge of stability: velocities grow without limit unless
    something bounds them, and the paper does not say what. Here no particle moves by more than
    a tenth of the box in one cycle, the usual limit (Eberhart and Shi 2001), and one that would
    leave the box stops at its wall, where its velocity across the wall is lost.

    Args:
        objective: scores a population, shape (P, d) -> (P,).
        lower: lower corner of the box, shape (d,).
        upper: upper corner.
        seed: the same seed gives the same result.
        speed_limit: in widths of the box; infinite for none but the walls.
    """
    rng = np.random.default_rng(seed)
    score = Scorer(objective)
    shape = INDIVIDUALS, lower.size
    x, velocity = rng.uniform(lower, upper, shape), np.zeros(shape)
    errors = score(x)
    own, own_errors = x, errors
    limit = speed_limit * (upper - lower)
    for _ in range(CYCLES - 1):
        leader = own[np.argmin(own_errors)]
        pull = BETA * rng.random(shape) * (own - x) + GAMMA * rng.random(shape) * (leader - x)
        velocity = np.clip(ALPHA * velocity + pull, -limit, limit)
        free = x + velocity
        x = np.clip(free, lower, upper)
        velocity = np.where(x == free, velocity, 0.0)
        errors = score(x)
        better = errors < own_errors
        own = np.where(better[:, None], x, own)
        own_errors = np.where(better, errors, own_errors)
    return score.result()
