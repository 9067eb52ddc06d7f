"""Evidence, regime by regime, that a newer model is worse than an older one, or holds.

In each regime two bets (`betting`) are on the relative gain of the newer model, in blocks of the
windows that belong to it. One is that its mean square is larger, by more than the reduction that
counts: it is worse there. The other is that its RMS is not larger by the rise that the live twin
would report: it holds there.
"""
from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.keep.betting import Bet, least_gain, relative_gain
from hydro_twin.keep.regimes import FEWEST, Grid, Known, regime, window_of
from hydro_twin.live.monitor import RISE
from hydro_twin.plants.plant import Plant
from hydro_twin.store.change import quantity

HOLDS = -least_gain(1.0 - RISE**-2)     # relative gain of a model whose RMS is larger by `RISE`


@dataclass
class Evidence:
    """Of one regime; sums are of squares, of the older and of the newer model.

    Attributes:
        order: how many regimes were visited before it.
        samples: that were judged.
        totals: sums over them.
    """

    order: int
    worse: Bet
    holds: Bet = field(default_factory=lambda: Bet(HOLDS))
    samples: int = 0
    totals: list[float] = field(default_factory=lambda: [0.0, 0.0])
    block: list[float] = field(default_factory=lambda: [0.0, 0.0])
    filled: int = 0          # samples of the block

    def bet(self, gain: float) -> None:
        """Bet on the gain of the newer model in a block, and begin the next."""
        self.worse.take(-gain)
        self.holds.take(gain)
        self.samples += self.filled
        self.totals = [total + one for total, one in zip(self.totals, self.block, strict=True)]
        self.block, self.filled = [0.0, 0.0], 0

    def rms(self) -> list[float | None]:
        """RMS of the older and of the newer model, in the unit of the output."""
        return [math.sqrt(total / self.samples) if self.samples else None
                for total in self.totals]


class Regimes:
    """Collects evidence on a newer model against an older one, regime by regime.

    Attributes:
        found: by regime, in the order of the first visits.
    """

    def __init__(self, grid: Grid, plant: Plant, sample_time: float, gain: float) -> None:
        """Collect from samples this far apart [s]; gain as in `duel.Rules`."""
        self.grid, self.plant, self.gain = grid, plant, gain
        self.sample_time = sample_time
        self.found: dict[str, Evidence] = {}
        self._signals = np.empty((1 + len(plant.inputs), window_of(sample_time)))
        self._rows = [0, *(k + 1 for k, signal in enumerate(plant.inputs) if not signal.held)]
        self.restart()

    def restart(self) -> None:
        """Begin a window: the next sample does not follow the last."""
        self._count = 0
        self._sums = [0.0, 0.0]

    def add(self, inputs: FloatArray, output: float, block: int, older: float, newer: float,
            ) -> None:
        """Take in a sample.

        Args:
            inputs: shape (m,).
            output: as measured.
            block: least samples of a bet.
            older: the squared residual of the older model.
            newer: that of the newer.
        """
        self._signals[0, self._count] = output
        self._signals[1:, self._count] = inputs
        self._sums[0] += older
        self._sums[1] += newer
        self._count += 1
        if self._count < self._signals.shape[1]:
            return
        one = self._here()
        one.block = [total + here for total, here in zip(one.block, self._sums, strict=True)]
        one.filled += self._count
        if one.filled >= block:
            one.bet(relative_gain(*one.block))
        self.restart()

    def note_divergence(self, older: bool, newer: bool) -> None:
        """Take note of which model diverged; where too few samples tell the regime, of none."""
        if self._count >= FEWEST:
            one = self._here()
            one.block, one.filled = [0.0, 0.0], 0
            one.bet(relative_gain(*(math.inf if lost else 0.0 for lost in (older, newer))))
        self.restart()

    def _here(self) -> Evidence:
        name = regime(self.grid, self.plant, self._signals[self._rows, :self._count])
        return self.found.setdefault(
            name, Evidence(len(self.found), Bet(least_gain(self.gain))))

    def worse(self, alpha: float) -> list[str]:
        """Name the regimes in which the newer model is worse.

        The probability of ever naming a regime in which it is not worse is at most alpha over all
        regimes: the k-th one visited is allotted alpha / (k (k + 1)), which sums to alpha.
        """
        return [name for name, one in self.found.items()
                if one.worse.log_capital >= math.log((one.order + 1) * (one.order + 2) / alpha)]

    def pending(self, known: Known, alpha: float) -> list[str]:
        """Name the regimes seen before in which the newer model is not shown to hold.

        Neither here nor in recordings; the probability that one in which it does not hold is ever
        taken for shown is at most alpha.
        """
        return [name for name in known.seen if known.holds.get(name, 0.0) < 1.0 / alpha
                and not (name in self.found
                         and self.found[name].holds.log_capital >= -math.log(alpha))]

    def record(self) -> dict[str, Any]:
        """Lay out what was found, by regime."""
        return {name: {'seconds': one.samples * self.sample_time, 'holds': one.holds.e_value,
                       'worse': one.worse.e_value,
                       **dict(zip(('rms_older', 'rms_newer'), one.rms(), strict=True))}
                for name, one in self.found.items()}

    def compared(self, name: str) -> str:
        """Say how the two do in a regime that was visited."""
        older, newer = self.found[name].rms()
        unit = self.plant.output.unit
        return (f'RMS {quantity(newer, unit)} against {quantity(older, unit)}'
                if older is not None and newer is not None else 'it diverges')
