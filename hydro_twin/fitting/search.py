"""What every population search shares: the objective, the count of cycles, the result."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hydro_twin.arrays import FloatArray

Objective = Callable[[FloatArray], FloatArray]      # (P, d) candidates -> (P,) errors

INDIVIDUALS, CYCLES = 100, 100                      # [B19] Table 2: 10^4 candidates


@dataclass(frozen=True)
class SearchResult:
    """The best candidate of a search.

    Attributes:
        best: shape (d,).
        error: its error.
        history: the learning curve: the least error so far after each cycle, shape (cycles,).
    """

    best: FloatArray
    error: float
    history: FloatArray


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
