"""The four optimisers of [B19], by the names that `--method` knows."""
from __future__ import annotations

from collections.abc import Callable

from hydro_twin.fitting.bees import bees
from hydro_twin.fitting.evolution import evolution
from hydro_twin.fitting.particle_swarm import particle_swarm
from hydro_twin.fitting.random_search import random_search
from hydro_twin.fitting.search import Objective, SearchResult
from hydro_twin.recording.series import FloatArray

METHODS: dict[str, Callable[[Objective, FloatArray, FloatArray, int], SearchResult]] = {
    'random': random_search,
    'ea': evolution,
    'pso': particle_swarm,
    'bees': bees,
}
