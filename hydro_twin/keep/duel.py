"""Two models side by side on the live samples, judged block by block."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any, Literal

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.keep.betting import Bet, least_gain, relative_gain
from hydro_twin.keep.regime_bets import Regimes
from hydro_twin.live.twin import Twin

Outcome = Literal['better', 'worse', 'open']
LEARN = 8.0         # from which the memory of the residuals is learned; not judged [s]
MEMORIES = 10.0     # times the memory is the length of a block
SHORTEST = 0.25     # block [s]
LOW = 8             # lowest frequencies that the memory is taken from


@dataclass(frozen=True)
class Rules:
    """When a duel ends.

    Attributes:
        alpha: probability that a challenger which is no better is ever called better.
        gain: least reduction of the mean squared residual, as a share, that counts.
        least: time before which none is called better [s].
    """

    alpha: float = 0.01
    gain: float = 0.02
    least: float = 60.0


def in_one_mode(one: Twin, other: Twin) -> tuple[Twin, Twin]:
    """Let two twins run in a mode in which both can, so that their residuals can be compared.

    Asked for the observer, a model that lacks its noise runs one_step, as every model can.
    """
    return (one, other) if one.mode == other.mode else (_one_step(one), _one_step(other))


def _one_step(twin: Twin) -> Twin:
    made = Twin(twin.name, twin.predictor, 'one_step', {**twin.about, 'mode': 'one_step'})
    made.warm_up()
    return made


class Duel:
    """Runs a champion and a challenger on the same samples, and bets on each block.

    Only samples that both models predict and that were measured count. A block in which one model
    diverged is lost by it.

    Attributes:
        seconds: of samples that both predicted.
        regimes: the evidence regime by regime, where regimes are known.
    """

    def __init__(self, champion: Twin, challenger: Twin, rules: Rules,
                 regimes: Regimes | None = None, newer: int = 1) -> None:
        """Judge two twins of one plant and one sample time.

        Args:
            champion: that runs.
            challenger: against it.
            rules: when it ends.
            regimes: collects the evidence regime by regime.
            newer: which of the two is the newer model, which `regimes` judges: 1 the challenger,
                0 the champion.
        """
        self.champion, self.challenger, self.rules = champion, challenger, rules
        self.regimes, self._newer = regimes, newer
        self.better, self.worse = Bet(least_gain(rules.gain)), Bet()
        self.sample_time = champion.predictor.sample_time
        self.samples = 0
        self.block = 0                       # samples; 0 while it is not known
        self._learned: list[tuple[float, float]] = []
        self._learn = max(round(LEARN / self.sample_time), 256)
        self._sums = [0.0, 0.0]              # of squares in this block
        self._totals = [0.0, 0.0]            # in all blocks
        self._count = 0
        self._counted = 0
        self._diverged = [champion.divergences, challenger.divergences]

    @property
    def seconds(self) -> float:
        """How long both have predicted [s]."""
        return self.samples * self.sample_time

    def restart(self) -> None:
        """Begin a run: the next sample is its first."""
        for twin in (self.champion, self.challenger):
            twin.reset()
        if self.regimes is not None:
            self.regimes.restart()

    def step(self, stamp: int, inputs: FloatArray, measured: float,
             sensors: FloatArray | None = None) -> None:
        """Step both by one sample; see `Twin.step`."""
        ours = self.champion.step(stamp, inputs, measured, sensors)
        theirs = self.challenger.step(stamp, inputs, measured, sensors)
        diverged = (self.champion.divergences > self._diverged[0]
                    or self.challenger.divergences > self._diverged[1])
        if diverged:
            self._close()
            return
        if (ours != ours or theirs != theirs or measured != measured        # nan
                or not (self.champion.scored and self.challenger.scored)):
            return
        self.take((measured - ours) ** 2, (measured - theirs) ** 2, inputs, measured)

    def _older_first[Of](self, champion: Of, challenger: Of) -> tuple[Of, Of]:
        return (champion, challenger) if self._newer else (challenger, champion)

    def take(self, a: float, b: float, inputs: FloatArray | None = None,
             measured: float = math.nan) -> None:
        """Take in one sample.

        Args:
            a: squared residual of the champion.
            b: that of the challenger.
            inputs: shape (m,); None where the regime is not known.
            measured: the output.
        """
        self.samples += 1
        if not self.block:
            self._learned.append((a, b))
            if len(self._learned) == self._learn:
                pairs = np.array(self._learned)
                needed = MEMORIES * max(map(autocorrelation_time, pairs.T))
                self.block = max(round(SHORTEST / self.sample_time), math.ceil(needed))
                self._learned = []
            return
        if self.regimes is not None and inputs is not None:
            self.regimes.add(inputs, measured, self.block, *self._older_first(a, b))
        self._sums[0] += a
        self._sums[1] += b
        self._count += 1
        if self._count >= self.block:
            self._close()

    def _close(self) -> None:
        """End a block, and bet on it."""
        lost = [self.champion.divergences > self._diverged[0],
                self.challenger.divergences > self._diverged[1]]
        self._diverged = [self.champion.divergences, self.challenger.divergences]
        if any(lost) and self.regimes is not None:
            self.regimes.note_divergence(*self._older_first(*lost))
        gain = (relative_gain(*(math.inf if one else 0.0 for one in lost)) if any(lost)
                else relative_gain(*self._sums))
        if not any(lost):
            self._totals = [total + one for total, one in zip(self._totals, self._sums,
                                                              strict=True)]
            self._counted += self._count
        self._sums, self._count = [0.0, 0.0], 0
        self.better.take(gain)
        self.worse.take(-gain)

    @property
    def outcome(self) -> Outcome:
        """What the evidence says of the challenger by now; it may be asked at any time."""
        enough = -math.log(self.rules.alpha)
        if self.worse.log_capital >= enough and self._totals[1] >= self._totals[0]:
            return 'worse'
        if (self.better.log_capital >= enough and self.seconds >= self.rules.least
                and self._totals[1] <= self._totals[0]):
            return 'better'
        return 'open'

    def evidence(self) -> Mapping[str, Any]:
        """Lay out what was found, for a record; RMS in the unit of the output."""
        rms = [math.sqrt(total / self._counted) if self._counted else None
               for total in self._totals]
        return {'e_value': self.better.e_value, 'against': self.worse.e_value,
                'needed': 1.0 / self.rules.alpha, 'alpha': self.rules.alpha,
                'least_gain': self.rules.gain, 'blocks': self.better.blocks,
                'block_s': self.block * self.sample_time, 'seconds': self.seconds,
                'mode': self.champion.mode,
                'rms_champion': rms[0], 'rms_challenger': rms[1],
                **({'regimes': self.regimes.record()} if self.regimes is not None else {})}


def autocorrelation_time(values: np.ndarray) -> float:
    """Estimate the correlation length of a signal [samples]: its integrated autocorrelation.

    The lowest frequencies of the periodogram give the variance of long means, which is divided by
    the variance of a sample; 1 for white noise.

    Args:
        values: shape (n,), in any unit.
    """
    centred = values - values.mean()
    variance = float(centred @ centred) / len(values)
    if variance == 0.0:
        return 1.0
    low = np.abs(np.fft.rfft(centred)[1:LOW + 1]) ** 2 / len(values)
    return max(float(low.mean()) / variance, 1.0)
