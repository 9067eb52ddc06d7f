"""The optimisers of [B19] and least squares, by the names that `--method` knows."""
from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydro_twin.fitting.bees import bees
from hydro_twin.fitting.evolution import evolution
from hydro_twin.fitting.one_step import Coefficients, least_squares, one_step_error
from hydro_twin.fitting.particle_swarm import particle_swarm
from hydro_twin.fitting.random_search import random_search
from hydro_twin.fitting.regression import Regression
from hydro_twin.fitting.search import Objective, SearchResult
from hydro_twin.plants import Plant
from hydro_twin.recording.series import FloatArray

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
    lower, upper = np.array([(p.lower, p.upper) for p in plant.parameters]).T
    if method == 'least_squares':
        names = [p.name for p in plant.parameters]
        return least_squares(factor, coefficients, names, plant.combinations, lower, upper, seed)
    return METHODS[method](one_step_error(factor, coefficients), lower, upper, seed)
