"""The analytical predictor: the plant's laws with the effects of its model."""
from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hydro_twin.plants import Plant
from hydro_twin.plants.difference_equation import bilinear
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors import kernel
from hydro_twin.predictors.kind import Kind
from hydro_twin.predictors.system import assemble, System
from hydro_twin.recording.series import Series

if TYPE_CHECKING:
    from hydro_twin.model import Model

HISTORY = 256                               # samples of inputs a live run keeps


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
        self.system = assemble(model.plant, model.values, model.placed, model.sample_time,
                               model.substeps, model.timing)
        shifted = bool(np.any(self.system.step.shift))
        self.linear = (assemble(model.plant, model.values, (), model.sample_time)
                       if len(self.system.step.effects) or shifted else None)
        self.equation = bilinear(self.system.laws, model.sample_time)

    def inputs(self, series: Series) -> FloatArray:
        """Stack the inputs of a series, shape (N, m)."""
        return np.column_stack([series[signal.name] for signal in self.plant.inputs])

    def one_step(self, series: Series) -> FloatArray:
        """Predict each sample from measured outputs up to the one before; see `Predictor`."""
        inputs = self.inputs(series)
        measured = series[self.plant.output.name]
        added = np.zeros(len(inputs))
        if self.linear is not None:
            start = _first(measured[0])
            added = (self.system.run(inputs, self.system.start(inputs[0], start))
                     - self.linear.run(inputs, self.linear.start(inputs[0], start)))
        y = np.empty(len(inputs))
        kernel.run_one_step(self.equation.a, self.equation.b, added, measured, inputs,
                            np.empty(len(inputs)), y)
        return y

    def free_run(self, series: Series) -> FloatArray:
        """Predict each sample with no measured output used after the first; see `Predictor`."""
        inputs = self.inputs(series)
        measured = series[self.plant.output.name]
        return self.system.run(inputs, self.system.start(inputs[0], _first(measured[0])))

    def stepper(self, mode: str) -> FreeRun | OneStep:
        """Start a live run; see `Predictor`."""
        return FreeRun(self.system) if mode == 'free_run' else OneStep(self)


def _first(measured: float) -> float:
    """Take the first measured output, or none at all, as the output at the start."""
    return float(measured) if math.isfinite(measured) else 0.0


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

    def step(self, inputs: FloatArray, measured: float) -> float:
        """Predict the output of the next sample; see `Stepper`."""
        s = self.system
        self.k += 1
        if self.k == len(self.inputs):
            self.inputs[:self.keep] = self.inputs[self.keep:]
            self.k = self.keep
        self.inputs[self.k] = inputs
        if self.k == 0:
            self.x[:] = s.start(inputs, _first(measured))
            y = kernel.output(s.step, self.x, self.z, self.work, self.inputs, 0)
        else:
            y = kernel.live_step(self.x, self.z, self.work, self.inputs, self.k, *s.step)
        return y if abs(y) < kernel.LIMIT else math.nan


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

    def step(self, inputs: FloatArray, measured: float) -> float:
        """Predict the output of the next sample; see `Stepper`."""
        self.k += 1
        if self.k == len(self.inputs):
            self.inputs[:self.keep] = self.inputs[self.keep:]
            self.past[:self.keep] = self.past[self.keep:]
            self.k = self.keep
        self.inputs[self.k] = inputs
        added = 0.0
        if self.full is not None and self.linear is not None:
            added = self.full.step(inputs, measured) - self.linear.step(inputs, measured)
        started = self.count >= len(self.equation.a)
        self.count += 1
        y: float = kernel.step_one(self.equation.a, self.equation.b, added, measured, self.inputs,
                                   self.past, self.k, started)
        return y


def make(model: Model, folder: Path) -> Analytical:     # noqa: ARG001
    """Make the predictor of a model; there are no weights in the folder."""
    return Analytical(model)


ANALYTICAL = Kind('analytical', 'an analytical model', make)
