"""A plant with an unknown input at one of its ports, and the observer that allows for it."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.plants.plant import Signal
from hydro_twin.predictors.fixed_gains import run_with_gains
from hydro_twin.predictors.observer import Observation, Observer

UNKNOWN = 'unknown_input'   # the name of the state that walks at random, and of the input


def with_unknown_input(plant: Plant, index: int, unit: float) -> Plant:
    """Add a constant state and an input to the value that reaches a port, both in a given unit.

    Process noise makes the state a random walk. Where only held commands reach the port, the input
    is held as well.

    Args:
        plant: the plant.
        index: of the port.
        unit: of state and input, in that of the port.
    """
    def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Any
                  ) -> Mapping[str, Any]:
        walk, given = getattr(x, UNKNOWN), getattr(u, UNKNOWN)
        passed = count()

        class Through:
            sensor = staticmethod(port.sensor)

            def __call__(self, name: str, value: Any, **signals: Any) -> Any:
                here = next(passed) == index
                return port(name, value + unit * (walk + given) if here else value, **signals)

        return {**plant.equations(p, x, u, Through()), UNKNOWN: 0.0 * walk}

    laws = plant.laws(plant.constant_values() | plant.middle())
    held = not laws.port_x[index].any() and all(
        signal.held for signal, share in zip(plant.inputs, laws.port_u[index], strict=True)
        if share)
    return replace(plant, states=(*plant.states, UNKNOWN), equations=equations,
                   inputs=(*plant.inputs, Signal(UNKNOWN, 'unknown input', '', held)))


@dataclass(frozen=True)
class Seen:
    """One run of an observer over N samples.

    Attributes:
        innovation: over its standard deviation, nan where nothing was measured, (N,).
        variance: of the innovation, in the unit of the output squared, (N,).
        passing: what reached the ports, then the signals there, as estimated from all
            measurements before the sample, (N, P + S); empty where that was not wanted.
        gains: of state and memory, (N, n + memory).
    """

    innovation: FloatArray
    variance: FloatArray
    passing: FloatArray
    gains: FloatArray

    def log_likelihood(self, begin: int) -> float:
        """Sum the logarithm of the likelihood from a sample on [nat], up to a constant."""
        e, v = self.innovation[begin:], self.variance[begin:]
        return -0.5 * float(np.nansum(np.where(np.isnan(e), 0.0, np.log(v)) + e * e))


def observe(observer: Observer, start: FloatArray, inputs: FloatArray, measured: FloatArray,
            shown: FloatArray | None = None) -> Seen:
    """Run an observer by the last stage of its system.

    Args:
        observer: the observer; what it shows is replaced.
        start: state of the plant at the first sample, (n,).
        inputs: (N, m).
        measured: the output, nan where there is none, (N,).
        shown: the rows of what passes at ports, (P + S, n + m + P), as in `Step.H`; without
            them the run is several times as fast.
    """
    system, n, m = observer.system, len(start), inputs.shape[1]
    if shown is not None:       # the inputs are known, and left to the end
        observer.filter = observer.filter._replace(shown=np.hstack([
            shown[:, :n], np.zeros((len(shown), system.memory + m)), shown[:, n + m:]]))
    observation = Observation(observer, start.copy(), np.zeros(system.memory))
    results = np.empty((len(inputs), 2))
    estimates = np.empty((0 if shown is None else len(inputs), 2, len(observer.filter.shown)))
    gains = np.zeros((len(inputs), n + system.memory))
    observation.advance(len(observer.stages) - 1, inputs, measured[:, None], 0, len(inputs),
                        results, estimates, gains)
    passing = estimates[:, 0]
    if shown is not None:
        # An estimate after a sample contains its noise, and so would explain it: extrapolate
        # linearly from the two samples before.
        passing = (np.vstack([passing[:1], passing[:1], 2.0 * passing[1:-1] - passing[:-2]])
                   + inputs @ shown[:, n:n + m].T)
    return Seen((measured - results[:, 0]) / np.sqrt(results[:, 1]), results[:, 1], passing, gains)


@dataclass(frozen=True)
class Suspect:
    """A port at which an unknown input may act on a stretch of samples.

    Attributes:
        model: with its noise.
        index: of the port.
        unit: of the unknown input, in that of the port.
        inputs, measured: of the stretch, (N, m) and (N,).
        onset: sample from which it may act.
        start: state of the plant at the first sample, (n,).
        process: root of the covariance that a sample adds to the states, (n, n).
    """

    model: Model
    index: int
    unit: float
    inputs: FloatArray
    measured: FloatArray
    onset: int
    start: FloatArray
    process: FloatArray

    @cached_property
    def observer(self) -> Observer:
        """The observer without the walk: between samples the unknown input stays as it is."""
        noise = self.model.noise
        assert noise is not None
        plant = with_unknown_input(self.model.plant, self.index, self.unit)
        found = Observer(replace(self.model, plant=plant).system,
                         replace(noise, process={}, start={**noise.start, UNKNOWN: 0.0}))
        found.filter = found.filter._replace(process=np.pad(self.process, ((0, 1), (0, 1))))
        return found

    def run(self, intensity: float, given: FloatArray | float = 0.0, passing: bool = False
            ) -> Seen:
        """Run the observer that takes the unknown input as a random walk beside a given one.

        Args:
            intensity: of the walk, in units over the root of a second.
            given: the other part from the onset on, in units, (N - onset,), or the same always.
            passing: whether what passes at the ports is wanted.
        """
        observer = self.observer
        step = observer.system.step
        observer.filter.process[-1, -1] = intensity * math.sqrt(step.sample_time)
        shown = step.H[:step.sensors].copy()
        n, m = len(step.M), len(step.shift)
        shown[self.index, [n - 1, n + m - 1]] = 0.0         # what the law at the port reads
        column = np.zeros(len(self.inputs))
        column[self.onset:] = given
        return observe(observer, np.append(self.start, 0.0),
                       np.column_stack([self.inputs, column]), self.measured,
                       shown if passing else None)

    def responses(self, seen: Seen, given: FloatArray) -> FloatArray:
        """Say how much smaller the innovation is where an unknown input is given.

        The gains stay as they are: what is given is known, and adds no uncertainty.

        Args:
            seen: by the observer without it.
            given: several inputs from the onset on, in units, (J, N - onset).

        Returns:
            Of each, over the standard deviation, (J, N - onset).
        """
        system, onset = self.observer.system, self.onset
        inputs = np.column_stack([self.inputs, np.zeros(len(self.inputs))])
        x, z, y = np.append(self.start, 0.0), np.zeros(system.memory), np.empty(len(inputs))
        found = np.empty((1 + len(given), len(inputs) - onset))
        step, work = system.stages[-1].step, system.work()
        run_with_gains(step, x, z, work, inputs, self.measured, seen.gains, y, 0, onset)
        for row, out in zip([np.zeros(found.shape[1]), *given], found, strict=True):
            inputs[onset:, -1] = row
            run_with_gains(step, x.copy(), z.copy(), work, inputs, self.measured, seen.gains, y,
                           onset, len(inputs))
            out[:] = y[onset:]
        responses: FloatArray = (found[1:] - found[0]) / np.sqrt(seen.variance[onset:])
        return responses


def reach(model: Model, index: int, inputs: FloatArray, start: FloatArray, probe: float) -> float:
    """Say how far a constant at a port moves the output in a free run, per unit of the port."""
    system = replace(model, plant=with_unknown_input(model.plant, index, probe)).system
    x = np.append(start, 0.0)
    rest, moved = (system.run(np.column_stack([inputs, np.full(len(inputs), value)]), x)
                   for value in (0.0, 1.0))
    far = float(np.nanmax(np.abs(moved - rest)))
    return far / probe if math.isfinite(far) else math.inf
