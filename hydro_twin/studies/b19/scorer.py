"""What every population search shares: its size, and the score of each population."""
from __future__ import annotations

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.one_step import Objective, SearchResult

INDIVIDUALS, CYCLES = 100, 100                      # [B19] Table 2: 10^4 candidates


class Scorer:
    """Score one population a cycle, and remember the best candidate ever seen."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self._best, self._error = np.empty(0), np.inf
        self._history: list[float] = []

    def __call__(self, population: FloatArray) -> FloatArray:
        """Score a population, shape (P, d); a candidate without a finite error is the worst."""
        errors = self._objective(population)
        errors = np.where(np.isfinite(errors), errors, np.inf)
        leader = int(np.argmin(errors))
        if errors[leader] < self._error or not self._history:
            self._best, self._error = population[leader].copy(), float(errors[leader])
        self._history.append(self._error)
        return errors

    def result(self) -> SearchResult:
        """Return the best so far."""
        return SearchResult(self._best, self._error, np.array(self._history))
