"""Where the predictions of one twin go, and what its observer estimates beside them."""
from __future__ import annotations

from collections.abc import Callable, Sequence

from hydro_twin.arrays import FloatArray
from hydro_twin.live.twin import Twin
from hydro_twin.live.writer import Writer

Publish = Callable[[bytes], object]


class Outlet:
    """Steps a twin and publishes its valid predictions; the twin can be replaced while running."""

    def __init__(self, twin: Twin, horizon: int, prediction: Publish, residual: Publish,
                 states: Publish, ahead: Publish, parameters: Publish) -> None:
        """Publish what a twin gives, as serialised JointStates.

        Args:
            twin: that is stepped.
            horizon: how many samples ahead `ahead` predicts.
            prediction: publishes the prediction of each sample.
            residual: publishes measured minus predicted, where the output was measured.
            states: publishes the estimated states and their standard deviations.
            ahead: publishes the prediction ahead and its standard deviation.
            parameters: publishes the followed parameters and their standard errors.
        """
        self.horizon = horizon
        self.states_wanted = False      # by a subscriber: nobody else needs the work
        self.ahead_wanted = False
        self.parameters_wanted = False
        plant = twin.predictor.plant
        self._writer = Writer([plant.output.name], plant.output.unit)
        self._ahead_writer = Writer(_with_errors([plant.output.name]), plant.output.unit)
        self._period = round(twin.predictor.sample_time * 1e9)
        self._prediction = prediction
        self._residual = residual
        self._states = states
        self._ahead = ahead
        self._parameters = parameters
        self._next: Twin | None = None
        self._left = 0   # steps that it has to start up
        self._take_over(twin)

    def exchange(self, twin: Twin) -> None:
        """Let a twin take over with its first prediction, so that its start-up costs none."""
        self._next = twin
        self._left = twin.predictor.plant.order

    def restart(self) -> None:
        """Begin a run: the next sample is its first."""
        if self._next is not None:
            self._take_over(self._next)
        self.twin.reset()

    def step(self, stamp: int, inputs: FloatArray, measured: float,
             sensors: FloatArray | None = None) -> None:
        """Step the twin by one sample; see `Twin.step`."""
        if self._next is not None:
            self._start_up(self._next, stamp, inputs, measured, sensors)
        twin = self.twin
        prediction = twin.step(stamp, inputs, measured, sensors)
        if prediction == prediction:   # not nan
            self._prediction(self._writer.write(stamp, prediction))
            if twin.residual == twin.residual:
                self._residual(self._writer.write(stamp, twin.residual))
            if self.states_wanted and self._states_writer is not None:
                self._states(self._states_writer.write(stamp, *twin.estimate.ravel()))
            if self.parameters_wanted and self._parameters_writer is not None:
                self._parameters(self._parameters_writer.write(stamp, *twin.parameters.ravel()))
            if self.ahead_wanted and (ahead := twin.ahead(self.horizon)) is not None \
                    and ahead[0] == ahead[0]:
                self._ahead(self._ahead_writer.write(stamp + self.horizon * self._period, *ahead))

    def _start_up(self, twin: Twin, stamp: int, inputs: FloatArray, measured: float,
                  sensors: FloatArray | None) -> None:
        """Step the twin that is to take over, until its next step is a prediction."""
        if not self._left:
            self._take_over(twin)
            return
        self._left -= 1
        twin.step(stamp, inputs, measured, sensors)

    def _take_over(self, twin: Twin) -> None:
        self.twin, self._next = twin, None
        self._states_writer, self._parameters_writer = (
            Writer(_with_errors(names), '') if names else None for names in twin.shown)


def _with_errors(names: Sequence[str]) -> list[str]:
    """Name quantities, then their standard deviations."""
    return [*names, *(f'{name}_std' for name in names)]
