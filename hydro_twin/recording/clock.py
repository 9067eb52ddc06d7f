"""Decides the clock of a job: the sample time at which a recording is read, fitted and run."""
from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
import math
from typing import Any, TYPE_CHECKING

import numpy as np

from hydro_twin.arrays import IntArray
from hydro_twin.errors import UserError
from hydro_twin.recording.grid import STEADY_SHARE
from hydro_twin.recording.jitter import remove_jitter
from hydro_twin.recording.signals import number

if TYPE_CHECKING:
    from hydro_twin.plants import Plant
    from hydro_twin.recording.bag import Samples

# Both are shares of a period. A tenth covers jitter and clocks that are off, and is far from the
# next rate in use; 200 ppm is more than a quartz is off.
ALIKE = 0.1
ROUND = 2e-4


@dataclass(frozen=True)
class Clock:
    """What a job knows of its clock before it has seen a recording; all in s.

    Attributes:
        given: the sample time that the configuration asks for, which decides; or None.
        usual: that of the model or of the plant, taken where the recording is as fast, within
            `ALIKE`, or there is none.
        finest: none below is taken, however fast the recording is.
    """

    given: float | None
    usual: float
    finest: float

    @property
    def unrecorded(self) -> float:
        """The sample time of a job without a recording [s]."""
        return self.given or self.usual

    def over(self, periods: Iterable[float]) -> float:
        """Return the sample time [s] for bags whose slowest periods are given.

        The longest of them, unless a sample time is given, or the longest is close to `usual`.
        """
        if self.given:
            return self.given
        longest = max(periods)
        if abs(longest - self.usual) <= ALIKE * self.usual:
            return self.usual
        return max(longest, self.finest)


def clock_of(plant: Plant, parameters: Mapping[str, Any], source: str,
             model: float | None = None) -> Clock:
    """Gather what is known of the clock of a job.

    Args:
        plant: the plant.
        parameters: of the configuration, flat; `sample_time` [s] in it decides, unless it is 0,
            the default of the node.
        source: where they come from.
        model: sample time [s] of the model that the job runs, if it runs one.

    Raises:
        UserError: `sample_time` is not a number, or below zero.
    """
    given = None
    if 'sample_time' in parameters:
        given = number(parameters['sample_time'], f'{source}: sample_time')
        if given < 0.0:
            raise UserError(f'{source}: sample_time must not be below zero, as {given:g} is')
        given = given or None
    if model is not None:
        return Clock(given, model, model)
    return Clock(given, plant.sample_time, plant.finest or plant.sample_time)


def slowest(bag: Mapping[str, Samples], held: Collection[str]) -> float:
    """Return the period [s] of the slowest measurement of a bag: what lies between is not known.

    Args:
        bag: name -> samples as recorded.
        held: the signals that keep their value until the next (commands); they set no clock.
    """
    return max(period(samples) for name, samples in bag.items() if name not in held)


def period(samples: Samples) -> float:
    """Return the time [s] from one sample of a signal to the next; 0 for a single sample.

    The mean of the usual pauses: neither a loss nor a stall counts, and jitter averages out.
    Receive times that are too unsteady for that are put on lines first, by `remove_jitter`. The
    result is rounded to three digits where that changes next to nothing.
    """
    pauses = np.diff(samples.stamps)
    if len(pauses) == 0:
        return 0.0
    usual = _usual(pauses)
    if not samples.stamped and len(usual) < STEADY_SHARE * len(pauses):
        usual = _usual(np.diff(remove_jitter(samples.stamps)))
    mean = 1e-9 * float(np.mean(usual))
    plain = float(f'{mean:.3g}')
    return plain if abs(plain - mean) <= ROUND * mean else round(mean, 9)


def _usual(pauses: IntArray) -> IntArray:
    """Keep the pauses that differ from their median by at most half of it."""
    typical = np.sort(pauses)[len(pauses) // 2]
    usual: IntArray = pauses[np.abs(pauses - typical) <= 0.5 * typical]
    return usual


def same(one: float, other: float) -> bool:
    """Whether two sample times [s] are one and the same, but for rounding."""
    return math.isclose(one, other, rel_tol=1e-6)


def check_live(given: Any, model: float) -> None:
    """Refuse a `sample_time` given to the node, if any, that is not its model's [s].

    Raises:
        UserError: they differ, or it is not a number.
    """
    if given is not None and not same(number(given, 'sample_time'), model):
        raise UserError(f'sample_time is {given} s, but the model runs at {model:g} s: leave it '
                        'out, the node takes the clock of its model')
