"""A plant with values and effects that a fit may try, and the stretches it runs over."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math

import numpy as np
from scipy.linalg import expm

from hydro_twin.effects import Placed
from hydro_twin.errors import DataError
from hydro_twin.fitting.start import find_start, Start, without_start
from hydro_twin.model import Estimate, FittedEffect, Model
from hydro_twin.plants import Plant
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.sensitivities import NONE, run_with_slopes, Tangent, tangent_of
from hydro_twin.predictors.system import assemble, System
from hydro_twin.recording.series import Recording

STILL = 0.1             # of the movement of a part: its begin is longer where it moves less
LOST = 10.0             # and less than so many times the noise
LONGEST = 8             # times the start-up of the plant
SCORED = 20             # least samples scored: some for each parameter, and for the noise


@dataclass(frozen=True)
class Part:
    """An uninterrupted stretch that a run covers: inputs (N, m), output measured (N,).

    Attributes:
        source: the bag that it comes from.
        start: stamp of the first sample [ns].
    """

    inputs: FloatArray
    measured: FloatArray
    source: str = ''
    start: int = 0

    def cut(self, first: int, last: int, sample_time: float) -> Part:
        """Take the samples from the first up to the last, which is not among them."""
        return replace(self, inputs=self.inputs[first:last], measured=self.measured[first:last],
                       start=self.start + first * round(1e9 * sample_time))

    def beginning(self, start_up: int) -> int:
        """How many samples show the state at the start: more where it hardly moves at first.

        Within a gap, nothing tells where until a side is met.

        Args:
            start_up: of the plant [samples].
        """
        noise = np.std(np.diff(self.measured, 2)) / math.sqrt(6.0)
        still = min(STILL * np.std(self.measured), LOST * noise)
        longest = min(LONGEST * start_up, len(self.measured) // 2)
        n = min(start_up, len(self.measured))
        while n < longest and np.std(self.measured[:n]) <= still:
            n *= 2
        return n


def parts_of(recording: Recording, plant: Plant) -> list[Part]:
    """Stack the columns of each series that is long enough to start a run and score it.

    Raises:
        DataError: no series is long enough, or the output never moves, or is not finite.
    """
    parts = [
        Part(np.column_stack([series[signal.name] for signal in plant.inputs]),
             np.ascontiguousarray(series[plant.output.name]), series.source, series.start)
        for series in recording.series if len(series) >= least_samples(plant, series.sample_time)]
    if not parts:
        longest = max(recording.series, key=len, default=None)
        raise DataError(
            'there is no series' if longest is None else
            f'no series is long enough: the longest has {len(longest)} samples, '
            f'{least_samples(plant, longest.sample_time)} are needed')
    if not all(np.isfinite(part.inputs).all() and np.isfinite(part.measured).all()
               for part in parts):
        raise DataError('the recording holds values that are not finite')
    if all(np.ptp(part.measured) == 0.0 for part in parts):
        raise DataError(f'{plant.output.name} never moves in the recording')
    return parts


def least_samples(plant: Plant, sample_time: float) -> int:
    """Count the samples that a series must have to be fitted: as many scored as for its start."""
    start_up = plant.start_samples(sample_time)
    return start_up + max(start_up, SCORED)


@dataclass(frozen=True)
class Candidate:
    """Values for everything a run needs.

    Attributes:
        values: parameters and constants.
        timing: how late each input acts [s], by name.
    """

    plant: Plant
    values: Mapping[str, float]
    sample_time: float
    effects: tuple[Placed, ...] = ()
    timing: Mapping[str, float] | None = None
    substeps: int = 2

    @cached_property
    def system(self) -> System:
        """What the kernel runs."""
        return assemble(self.plant, self.values, self.effects, self.sample_time, self.substeps,
                        self.timing)

    @cached_property
    def start_tangents(self) -> tuple[Tangent, ...]:
        """Derivatives of a step of each stage of the system by the state at the start."""
        return tuple(tangent_of(system, NONE) for system in self.system.stages)

    @cached_property
    def start_up(self) -> int:
        """How many samples at the begin of a part set its state, and are not scored."""
        return self.plant.start_samples(self.sample_time)

    @classmethod
    def of(cls, model: Model) -> Candidate:
        """Take the values of a model."""
        return cls(model.plant, model.values, model.sample_time, model.placed,
                   dict(model.timing), model.substeps)

    def model(self) -> Model:
        """Make a model of the same values, which promises nothing."""
        constants = {c.name: self.values[c.name] for c in self.plant.constants}
        return Model(
            self.plant, {p.name: Estimate(self.values[p.name]) for p in self.plant.parameters},
            constants, self.sample_time, effects=tuple(map(FittedEffect, self.effects)),
            timing=dict(self.timing or {}), substeps=self.substeps)

    def without(self, index: int) -> Candidate:
        """Take one of the effects out."""
        return replace(self, effects=(*self.effects[:index], *self.effects[index + 1:]))

    def start(self, part: Part) -> Start:
        """Find the state at the begin of a part that its first samples show."""
        n = part.beginning(self.start_up)
        least = max(1e-3 * rms(part.measured), 1e-12)
        response = self.first_response if n <= self.start_up else self.free_response(n)
        (stage, *_), *_ = self.system.stretches(1, part.start)
        return find_start(self.system.stages[stage], self.start_tangents[stage], response[:n],
                          part.inputs[:n], part.measured[:n], least)

    def free_response(self, samples: int) -> FloatArray:
        """How the output moves with the state at the start, linear laws, (samples, n)."""
        laws = self.system.laws
        response, step = laws.C[:1], expm(laws.A * self.sample_time)
        while len(response) < samples:
            response, step = np.vstack([response, response @ step]), step @ step
        return response[:samples]

    @cached_property
    def first_response(self) -> FloatArray:
        """How the output moves with the state over the start-up, linear laws, (start-up, n)."""
        return self.free_response(self.start_up)

    @cached_property
    def usual_response(self) -> FloatArray:
        """RMS of the output's response to the state at the start, linear laws, (n,)."""
        response: FloatArray = np.sqrt(np.mean(self.first_response**2, axis=0))
        return response

    def run(self, part: Part, seen: FloatArray | None = None) -> FloatArray:
        """Run freely over a part, from the state that its first samples show; (N,)."""
        start = self.start(part)
        return self.system.run(part.inputs, start.x, start.z, seen, part.start)

    def residual(self, part: Part) -> FloatArray:
        """Measured less free run over the scored samples of a part, (N - start-up,)."""
        return (part.measured - self.run(part))[self.start_up:]

    def fitted_residuals(self, parts: Sequence[Part], starts: Sequence[Start] = ()
                         ) -> list[FloatArray]:
        """Find the residual of each part that is left if the whole of it shows its start.

        See `without_start`. What is not fitted has only its first samples to go by.

        Args:
            parts: what is run over.
            starts: of the runs, to save the search for them.
        """
        residuals = []
        for part, start in zip(parts, starts or map(self.start, parts), strict=True):
            y, slopes = run_with_slopes(self.system, NONE, self.start_tangents, part.inputs,
                                        start.x, start.z, part.start)
            residuals.append(without_start(part.measured - y, slopes, self.usual_response,
                                           self.start_up).residual)
        return residuals

    def residuals_from(self, parts: Sequence[Part], states: Sequence[FloatArray]
                       ) -> list[FloatArray]:
        """Find the residuals of runs from given states, less what others explain by linear laws.

        A quicker `fitted_residuals`, to compare many effects: no start is searched, and what
        effects keep is zero at first.

        Args:
            parts: what is run over.
            states: of each part, (n,).
        """
        response = self.free_response(max(len(part.measured) for part in parts))
        return [without_start(part.measured - self.system.run(part.inputs, x, start=part.start),
                              response[:len(part.measured)], self.usual_response,
                              self.start_up).residual
                for part, x in zip(parts, states, strict=True)]
