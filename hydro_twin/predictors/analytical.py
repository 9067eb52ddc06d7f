"""The analytical predictor: the plant's laws with the effects of its model."""
from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import ModelError
from hydro_twin.plants import Plant
from hydro_twin.plants.difference_equation import bilinear
from hydro_twin.predictors import kernel
from hydro_twin.predictors.kind import Kind
from hydro_twin.predictors.predictor import OBSERVER
from hydro_twin.predictors.system import assemble, HOLD, System
from hydro_twin.recording.series import Series

if TYPE_CHECKING:
    from hydro_twin.model import Model
    from hydro_twin.predictors.observer import Observer

HISTORY = 256           # samples of inputs a live run keeps, at least


class Analytical:
    """Runs a plant with effects.

    Free run integrates the laws. One step is eq. 1 on the measured past, less what the effects
    add to it, plus what they add now: with c = y_s - y_0, the free runs with and without effects,
        y(k) = c(k) + eq. 1 on y - c,
    which without effects is eq. 1 itself.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.plant: Plant = model.plant
        self.sample_time = model.sample_time
        self.system = model.system
        otherwise = bool(np.any(self.system.step.shift)) or model.interpolation != HOLD
        self.linear = (assemble(model.plant, model.values, (), model.sample_time)
                       if len(self.system.step.effects) or otherwise or self.system.earlier
                       else None)
        self.equation = bilinear(self.system.laws, model.sample_time)

    def inputs(self, series: Series) -> FloatArray:
        """Stack the inputs of a series, shape (N, m)."""
        return np.column_stack([series[signal.name] for signal in self.plant.inputs])

    def measured(self, series: Series) -> FloatArray:
        """Stack what the observer takes in, nan where there is none.

        Returns:
            The output, (N, 1); where the model knows the noise of a sensor, the output and the
            sensors of the plant, (N, 1 + R).
        """
        sensors = self.plant.sensors if self.model.noise and self.model.noise.sensors else ()
        return series.stacked([signal.name for signal in (self.plant.output, *sensors)])

    def one_step(self, series: Series) -> FloatArray:
        """Predict each sample from measured outputs up to the one before; see `Predictor`."""
        inputs = self.inputs(series)
        measured = series[self.plant.output.name]
        added = np.zeros(len(inputs))
        if self.linear is not None:
            start = measured[0]
            x = self.system.at(series.start).start(inputs[0], start)
            added = (self.system.run(inputs, x, start=series.start)
                     - self.linear.run(inputs, self.linear.start(inputs[0], start)))
        y = np.empty(len(inputs))
        kernel.run_one_step(self.equation.a, self.equation.b, added, measured, inputs,
                            np.empty(len(inputs)), y)
        return y

    def free_run(self, series: Series) -> FloatArray:
        """Predict each sample with no measured output used after the first; see `Predictor`."""
        inputs = self.inputs(series)
        measured = series[self.plant.output.name]
        x = self.system.at(series.start).start(inputs[0], measured[0])
        return self.system.run(inputs, x, start=series.start)

    def sensors(self, series: Series) -> dict[str, FloatArray]:
        """Run freely; returns what the sensors of the plant would read, by name, each (N,)."""
        inputs = self.inputs(series)
        x = self.system.at(series.start).start(
            inputs[0], series[self.plant.output.name][0])
        seen = np.full((len(inputs), len(self.system.step.H)), np.nan)
        self.system.run(inputs, x, seen=seen, start=series.start)
        return {sensor.name: seen[:, self.system.step.sensors + k]
                for k, sensor in enumerate(self.plant.sensors)}

    def observer(self, series: Series) -> FloatArray:
        """Predict each sample by the observer, from measured outputs up to the one before; (N,).

        Raises:
            ModelError: the model has no noise.
        """
        return self.filter.run(self.inputs(series), self.measured(series),
                               start=series.start)[0][:, 0]

    def observed(self, series: Series) -> tuple[FloatArray, FloatArray]:
        """Run the observer; returns what `observer` does, and the estimates of `Observer.run`.

        Raises:
            ModelError: the model has no noise.
        """
        results, estimates = self.filter.run(
            self.inputs(series), self.measured(series), True, series.start)
        return results[:, 0], estimates

    @cached_property
    def filter(self) -> Observer:
        """The observer; its module is imported when one is needed, since it compiles derivatives.

        Raises:
            ModelError: the model has no noise, or lacks a parameter that is to be followed.
        """
        from hydro_twin.predictors.follow import followed_of
        from hydro_twin.predictors.observer import Observer

        noise = self.model.noise
        if noise is None:
            raise ModelError('the model has no section `observer`, which that mode needs: `refit` '
                             'and `trace` write it')
        return Observer(self.system, noise, followed_of(self.model, self.system, noise.follow))

    def stepper(self, mode: str) -> FreeRun | OneStep:
        """Start a live run; see `Predictor`."""
        if mode == OBSERVER:
            return Observed(self.filter)
        return FreeRun(self.system) if mode == 'free_run' else OneStep(self)


def deviations(predictor: Analytical, estimates: Sequence[FloatArray]
               ) -> dict[str, dict[str, float | None]]:
    """Say how well the observer knows each state, and how well without a measurement.

    Args:
        predictor: with the observer.
        estimates: of each series, by `Analytical.observed`.

    Returns:
        For each quantity 'std', the median over the samples of its standard deviation after a
        measurement, and 'free_run', the same without measurements, None of what is no state of the
        plant; in SI units.

    Raises:
        ModelError: the model has no noise.
    """
    start = predictor.model.noise.start if predictor.model.noise else {}
    found = np.nanmedian(np.concatenate(estimates)[:, 1], axis=0)
    return {name: {'std': float(std), 'free_run': start.get(name)}
            for name, std in zip(predictor.filter.names, found, strict=False)}


class FreeRun:
    """A free run, live."""

    def __init__(self, system: System) -> None:
        self.system = system
        late = int(np.ceil(max(system.step.shift, default=0.0)))
        self.keep = max(HISTORY, late + 8)
        self.inputs = np.zeros((2 * self.keep, len(system.step.shift)))
        self.k = -1
        self.x = np.zeros(len(system.laws.A))
        self.z = np.zeros(system.memory)
        self.work = system.work()

    def step(self, inputs: FloatArray, measured: float, stamp: int | None = None,
             sensors: FloatArray | None = None) -> float:   # noqa: ARG002
        """Predict the output of the next sample; see `Stepper`."""
        system = self.system.at(stamp) if self.system.earlier else self.system
        self.k += 1
        if self.k == len(self.inputs):
            self.forget()
        self.inputs[self.k] = inputs
        if self.k > 0:
            y: float = kernel.live_step(self.x, self.z, self.work, self.inputs, self.k,
                                        *system.live)
        else:
            self.x[:] = system.start(inputs, measured)
            y = kernel.output(system.step, self.x, self.z, self.work, self.inputs, 0, False)
        return y

    def forget(self) -> None:
        """Move the newest samples to the front."""
        self.inputs[:self.keep] = self.inputs[self.keep:]
        self.k = self.keep


class Observed(FreeRun):
    """A run of the observer, live."""

    def __init__(self, observer: Observer) -> None:
        from hydro_twin.predictors.observer import Observation

        super().__init__(observer.system)
        self.observer, self.observation = observer, Observation(observer, self.x, self.z)
        known = np.isfinite(observer.filter.variances)
        self.uses_sensors = bool(known[1:].any())
        outputs = len(known) if self.uses_sensors else 1
        self.measured = np.full((len(self.inputs), outputs), math.nan)
        self.results = np.empty((len(self.inputs), 2 * outputs))
        self.estimates = np.empty((len(self.inputs), 2, len(observer.filter.shown)))

    def step(self, inputs: FloatArray, measured: float, stamp: int | None = None,
             sensors: FloatArray | None = None) -> float:
        """Predict the output of the next sample; see `Stepper`."""
        self.k += 1
        if self.k == len(self.inputs):
            self.forget()
        self.inputs[self.k] = inputs
        if self.k == 0:
            self.x[:] = self.system.at(stamp).start(inputs, measured)
        self.measured[self.k, 0] = measured
        if self.uses_sensors:
            self.measured[self.k, 1:] = math.nan if sensors is None else sensors
        self.observation.advance(self.system.stage_at(stamp), self.inputs, self.measured, self.k,
                                 self.k + 1, self.results, self.estimates)
        return float(self.results[self.k, 0])

    def forget(self) -> None:
        """Move the newest samples to the front, and what belongs to them."""
        super().forget()
        for kept in (self.measured, self.results, self.estimates):
            kept[:self.keep] = kept[self.keep:]

    @property
    def deviation(self) -> float:
        """Standard deviation of the innovation at the last sample."""
        return math.sqrt(self.results[self.k, 1])

    @property
    def estimate(self) -> FloatArray:
        """What the observer shows at the last sample, and the standard deviations, (2, R)."""
        estimate: FloatArray = self.estimates[self.k, :, :len(self.observer.names)]
        return estimate

    @property
    def parameters(self) -> FloatArray | None:
        """Values of the parameters that are followed, and their standard errors, (2, Q)."""
        if (followed := self.observer.followed) is None:
            return None
        return followed.in_units(self.estimates[self.k, :, len(self.observer.names):])

    def ahead(self, samples: int) -> tuple[float, float]:
        """Predict the output so many samples after the last, with all inputs held.

        Returns:
            The output and its standard deviation, as it would be measured; nan where the run
            diverges.
        """
        known = min(self.k + 1, self.keep)
        inputs = np.empty((known + samples, self.inputs.shape[1]))
        inputs[:known] = self.inputs[self.k + 1 - known:self.k + 1]
        inputs[known:] = self.inputs[self.k]
        results = np.empty((len(inputs), 2))
        self.observation.copy().advance(
            len(self.observer.stages) - 1, inputs, np.full((len(inputs), 1), math.nan), known,
            len(inputs), results, np.empty((0, *self.estimates.shape[1:])))
        return float(results[-1, 0]), math.sqrt(results[-1, 1])


class OneStep:
    """One-step prediction, live."""

    def __init__(self, predictor: Analytical) -> None:
        self.equation = predictor.equation
        order = len(self.equation.a)
        self.full = None
        self.linear = None
        if predictor.linear is not None:
            self.full, self.linear = FreeRun(predictor.system), FreeRun(predictor.linear)
        self.keep = max(HISTORY, order + 1)
        self.inputs = np.zeros((2 * self.keep, len(predictor.plant.inputs)))
        self.past = np.zeros(2 * self.keep)
        self.count = 0
        self.k = -1

    def step(self, inputs: FloatArray, measured: float, stamp: int | None = None,
             sensors: FloatArray | None = None) -> float:   # noqa: ARG002
        """Predict the output of the next sample; see `Stepper`."""
        self.k += 1
        if self.k == len(self.inputs):
            self.inputs[:self.keep] = self.inputs[self.keep:]
            self.past[:self.keep] = self.past[self.keep:]
            self.k = self.keep
        self.inputs[self.k] = inputs
        added = 0.0
        if self.full is not None and self.linear is not None:
            added = self.full.step(inputs, measured, stamp) - self.linear.step(inputs, measured)
        started = self.count >= len(self.equation.a)
        self.count += 1
        y: float = kernel.step_one(self.equation.a, self.equation.b, added, measured, self.inputs,
                                   self.past, self.k, started)
        return y


def make(model: Model, folder: Path) -> Analytical:     # noqa: ARG001
    """Make the predictor of a model; there are no weights in the folder."""
    return Analytical(model)


ANALYTICAL = Kind('analytical', 'an analytical model', make)
