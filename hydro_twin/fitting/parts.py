"""The stretches of a recording that a fit runs over."""
from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
import math

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.errors import DataError
from hydro_twin.fitting.autoregression import filtered
from hydro_twin.plants import Plant
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Recording

STILL = 0.1             # of the movement of a part: more first samples where it moves less
LOST = 10.0             # and less than so many times the noise
LONGEST = 8             # times the start-up of the plant
SCORED = 20             # least samples scored: some for each parameter, and for the noise


@dataclass(frozen=True)
class Part:
    """An uninterrupted stretch that a run covers: inputs (N, m), output measured (N,).

    Attributes:
        source: the bag that it comes from.
        start: stamp of the first sample [ns].
        sensors: what else was measured, by name, nan where it is missing, each (N,).
        travel: between which values the output was in all that was recorded, held-out data too:
            there is no stop in between. None: in nothing but the parts that are run over.
        filters: that whiten the noise of output and sensors, as `noise_filter` makes them, so that
            the sum of squares of a residual is its likelihood; none where it is taken as white.
    """

    inputs: FloatArray
    measured: FloatArray
    source: str = ''
    start: int = 0
    sensors: Mapping[str, FloatArray] = field(default_factory=dict)
    travel: tuple[float, float] | None = None
    filters: tuple[FloatArray, ...] = ()

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Filter a residual of the output, or its derivatives, (N, ...), to white noise."""
        return filtered(self.filters[0], columns) if self.filters else columns

    def cut(self, first: int, last: int, sample_time: float) -> Part:
        """Take the samples from the first up to the last, which is not among them."""
        return replace(
            self, inputs=self.inputs[first:last], measured=self.measured[first:last],
            start=self.start + first * round(1e9 * sample_time),
            sensors={name: column[first:last] for name, column in self.sensors.items()})

    def first_samples(self, start_up: int) -> int:
        """How many samples show the initial state: more where the output hardly moves at first.

        Within a gap, nothing tells where until a side is met.

        Args:
            start_up: of the plant [samples].
        """
        longest = min(LONGEST * start_up, len(self.measured) // 2)
        n = min(start_up, len(self.measured))
        while n < longest and np.std(self.measured[:n]) <= self.still:
            n *= 2
        return n

    @cached_property
    def still(self) -> float:
        """How much the output moves where it hardly does, RMS."""
        noise = np.std(np.diff(self.measured, 2)) / math.sqrt(6.0)
        return float(min(STILL * np.std(self.measured), LOST * noise))

    @cached_property
    def size(self) -> float:
        """RMS of the output."""
        return rms(self.measured)


def parts_of(recording: Recording, plant: Plant) -> list[Part]:
    """Stack the columns of each series that is long enough to start a run and score it.

    Raises:
        DataError: no series is long enough, or the output never moves, is not finite, or so large
            that a run which follows it counts as diverged.
    """
    parts = [
        Part(np.column_stack([series[one.name] for one in plant.inputs]),
             np.ascontiguousarray(series[plant.output.name]), series.source, series.start,
             {sensor.name: series[sensor.name] for sensor in plant.sensors
              if sensor.name in series.columns})
        for series in recording.series if len(series) >= least_samples(plant, series.sample_time)]
    if not parts:
        if not recording.series:
            raise DataError('there is no series')
        longest = max(recording.series, key=len)
        n, needed = len(longest), least_samples(plant, longest.sample_time)
        raise DataError(
            f'no series is long enough for a {plant.title}: the longest has {n} samples '
            f'({n * longest.sample_time:.3g} s), {needed} ({needed * longest.sample_time:.3g} s) '
            'are needed')
    if not all(np.isfinite(part.inputs).all() and np.isfinite(part.measured).all()
               for part in parts):
        raise DataError('the recording holds values that are not finite')
    largest = max(float(np.abs(part.measured).max()) for part in parts)
    if not largest < LIMIT:
        raise DataError(f'{plant.output.name} reaches {largest:.3g} {plant.output.unit} in the '
                        f'recording, and a run beyond {LIMIT:g} has diverged: is its scale right?')
    if all(np.ptp(part.measured) == 0.0 for part in parts):
        raise DataError(f'{plant.output.name} never moves in the recording')
    return parts


def movement(pieces: Sequence[FloatArray]) -> float:
    """RMS of what is measured, nan where it is not, about the mean of each piece; never zero."""
    there = [piece[np.isfinite(piece)] for piece in pieces]
    return max(rms(np.concatenate([piece - piece.mean() for piece in there if len(piece)])),
               1e-300)


def edges_of(lengths: Iterable[int]) -> IntArray:
    """Return where each of some pieces begins if they follow one another, and where all end."""
    return np.cumsum([0, *lengths])


def with_travel(*recorded: Sequence[Part]) -> list[list[Part]]:
    """Give every part the range of the output in all of them."""
    travel = travel_of([part for parts in recorded for part in parts])
    return [[replace(part, travel=travel) for part in parts] for parts in recorded]


def travel_of(parts: Sequence[Part]) -> tuple[float, float]:
    """Return between which values the output was measured, but for a hundredth of the samples."""
    if parts[0].travel is not None:
        return parts[0].travel
    return moved_between(parts)


def moved_between(parts: Sequence[Part]) -> tuple[float, float]:
    """Return between which values the output of these parts is, but for a hundredth of it."""
    low, high = np.quantile(np.concatenate([part.measured for part in parts]), [0.005, 0.995])
    return float(low), float(high)


def least_samples(plant: Plant, sample_time: float) -> int:
    """Count the samples that a fit needs of a series: as many scored as for its initial state."""
    start_up = plant.start_samples(sample_time)
    return start_up + max(start_up, SCORED)


def thin(parts: Sequence[Part], plant: Plant, factor: int) -> list[Part]:
    """Keep every so many samples; of commands, which are held, the mean until the next."""
    if factor == 1:
        return list(parts)
    thinned = []
    for part in parts:
        n = len(part.measured) // factor * factor
        held = part.inputs[:n].reshape(-1, factor, part.inputs.shape[1]).mean(axis=1)
        inputs = np.where([one.held for one in plant.inputs], held, part.inputs[:n:factor])
        thinned.append(replace(part, inputs=np.ascontiguousarray(inputs),
                               measured=np.ascontiguousarray(part.measured[:n:factor]),
                               sensors={name: column[:n:factor]
                                        for name, column in part.sensors.items()}))
    return thinned
