"""One model on the live samples: reset when it diverges, its residual monitored."""
from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.live.locator import Locator
from hydro_twin.live.monitor import Monitor, Rise
from hydro_twin.predictors.predictor import OBSERVER, Predictor
from hydro_twin.predictors.scores import unscored

MAIN = 'main'      # what diagnostics call the twin without a name
ABSURD = 1000.0   # times a typical large output: a prediction beyond it has diverged


class Twin:
    """Runs one predictor, resets it when it diverges, and watches its residual.

    Attributes:
        predictions: how many were made.
        divergences: how often a run diverged and was begun anew.
        residual: the last one, nan where nothing was measured [unit of the output].
    """

    def __init__(self, name: str, predictor: Predictor, mode: str,
                 about: Mapping[str, Any] | None = None) -> None:
        """Run a predictor.

        Args:
            name: among the topics, '' for the main one.
            predictor: of any kind.
            mode: one of `modes_of` its model.
            about: what to tell others of the model.
        """
        self.name = name
        self.about = about or {}
        self.predictor = predictor
        self.mode = mode
        self.predictions = 0
        self.divergences = 0
        self.residual = math.nan
        self.reference_rms = predictor.model.record.reference_rms(mode)
        self._unscored = unscored(predictor.plant, predictor.sample_time, mode)
        noise = predictor.model.noise
        self._expected = noise.innovation if noise and mode == OBSERVER else None
        self._limit = ABSURD * predictor.plant.output_scale
        self.start_over()

    def start_over(self) -> None:
        """Begin a run, and watch the residual anew."""
        self.monitor = (
            Monitor(self.reference_rms, self.predictor.sample_time, self.mode == OBSERVER)
            if self.reference_rms else None)
        model = self.predictor.model
        # What is followed is not the model's any more.
        self._locator = (Locator(model) if self.mode == OBSERVER and self.reference_rms
                         and model.noise is not None and not model.noise.follow else None)
        self.reset()

    def reset(self) -> None:
        """Begin a run: the next sample is its first."""
        self._stepper = self.predictor.stepper(self.mode)
        self._step = self._stepper.step
        self._running = False
        self._silent = 0        # measured samples in a row without a prediction
        self._count = 0
        if self._locator is not None:
            self._locator.clear()

    def judge(self) -> Rise | None:
        """Judge the residual, off the hot path, now and then.

        Returns:
            A rise when it has just been found, of an observer some seconds later, when it is also
            known where the fault enters.
        """
        monitor, locator = self.monitor, self._locator     # which `start_over` replaces
        if monitor is None:
            return None
        rise = monitor.judge()
        if locator is None:
            return rise
        if rise is not None:
            locator.take(rise)
        if (located := locator.located()) is not None:
            monitor.rise = located
        return located

    @property
    def locating(self) -> bool:
        """Whether it is being found where a fault enters, which `judge` will return."""
        return self._locator is not None and self._locator.at_work

    @property
    def shown(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the states that are estimated, and of the parameters that are followed."""
        observer = getattr(self._stepper, 'observer', None)
        if observer is None:
            return (), ()
        return observer.names, observer.followed.names if observer.followed else ()

    @property
    def estimate(self) -> FloatArray:
        """States at the last sample and their standard deviations, (2, R), as `shown`."""
        estimate: FloatArray = self._stepper.estimate       # type: ignore[attr-defined]
        return estimate

    @property
    def parameters(self) -> FloatArray:
        """Parameters that are followed, and their standard errors, (2, Q), as `shown`."""
        parameters: FloatArray = self._stepper.parameters   # type: ignore[attr-defined]
        return parameters

    @property
    def sensors(self) -> Mapping[str, bool]:
        """The sensors whose noise the model knows, and whether each is believed by now."""
        observation = getattr(self._stepper, 'observation', None)
        return {} if observation is None else observation.believed

    def ahead(self, samples: int) -> tuple[float, float] | None:
        """Predict the output so many samples after the last, and its standard deviation.

        Returns None in a mode that does not estimate states.
        """
        predict = getattr(self._stepper, 'ahead', None)
        return None if predict is None else predict(samples)

    def warm_up(self) -> None:
        """Step until a prediction comes, so that all is compiled before the first sample."""
        stepper, plant = self.predictor.stepper(self.mode), self.predictor.plant
        for _ in range(plant.order + 2):
            stepper.step(np.zeros(len(plant.inputs)), 0.0)

    def _normalised_residual(self) -> float:
        """Return the last residual, scaled to the innovation's standard deviation.

        That is the one with all the sensors that the model was fitted with. While one of them is
        missing the observer knows less, and so expects a larger residual.
        """
        if self._expected is None:
            return self.residual
        deviation: float = self._stepper.deviation      # type: ignore[attr-defined]
        return self.residual * self._expected / deviation

    @property
    def scored(self) -> bool:
        """Whether the last sample is past the start-up, which is not scored."""
        return self._count > self._unscored

    def step(self, stamp: int, inputs: FloatArray, measured: float,
             sensors: FloatArray | None = None) -> float:
        """Predict the output of the next sample.

        Args:
            stamp: of the sample [ns].
            inputs: shape (m,).
            measured: the output, nan where it is not known.
            sensors: what is measured beside it, see `Stepper`.

        Returns:
            The prediction, nan while the run starts up or where it has diverged.

        A run may diverge before its first prediction, as one that begins with a wild value: its
        prediction is too large, or nan for more measured samples than any start-up takes.
        """
        prediction = self._step(inputs, measured, stamp, sensors)
        self._count += 1
        if self._locator is not None:
            self._locator.add(stamp, inputs, measured)
        if not abs(prediction) <= self._limit:
            self._silent = self._silent + 1 if measured == measured else 0     # not nan
            if (self._running or prediction == prediction
                    or self._silent > self.predictor.plant.order + 1):
                self.divergences += 1
                self.reset()
            self.residual = math.nan
            return math.nan
        self._running = True
        self.predictions += 1
        self.residual = measured - prediction
        if (self.monitor is not None and self.residual == self.residual     # not nan
                and self.scored):                                           # as the reference
            self.monitor.add(stamp, self._normalised_residual())
        return prediction
