"""The optimisers of [B19], as methods of `refit`, and beside least squares in the study."""
from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting import physics
from hydro_twin.fitting.one_step import (
    box,
    Coefficients,
    Objective,
    one_step_error,
    search_least_squares,
    SearchResult,
)
from hydro_twin.fitting.physics import Method
from hydro_twin.fitting.regression import Regression
from hydro_twin.plants import Plant
from hydro_twin.studies.b19.bees import bees
from hydro_twin.studies.b19.evolution import evolution
from hydro_twin.studies.b19.particle_swarm import particle_swarm
from hydro_twin.studies.b19.random_search import random_search

METHODS: dict[str, Callable[[Objective, FloatArray, FloatArray, int], SearchResult]] = {
    'random': random_search,
    'ea': evolution,
    'pso': particle_swarm,
    'bees': bees,
}


def fit_one_step(
    method: str, factor: Regression, coefficients: Coefficients, plant: Plant, seed: int,
) -> SearchResult:
    """Search the plant's box for the least one-step error, by least squares or one of METHODS."""
    if method == 'least_squares':
        return search_least_squares(factor, coefficients, plant, seed)
    return METHODS[method](one_step_error(factor, coefficients), *box(plant), seed)


RANDOM, EA, PSO, BEES = (
    Method(name, partial(physics.fit_one_step, search=partial(fit_one_step, name)))
    for name in METHODS)
