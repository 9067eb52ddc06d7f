"""Where the predictions of one twin go."""
from __future__ import annotations

from collections.abc import Callable

from hydro_twin.live.twin import Twin
from hydro_twin.live.writer import Writer
from hydro_twin.plants.plant import FloatArray

Publish = Callable[[bytes], object]


class Outlet:
    """Steps a twin and publishes what it can stand behind; its twin may be exchanged."""

    def __init__(self, twin: Twin, prediction: Publish, residual: Publish) -> None:
        """Publish serialised JointStates."""
        self.twin = twin
        output = twin.predictor.plant.output
        self._writer = Writer(output.name, output.unit)
        self._prediction = prediction
        self._residual = residual

    def step(self, stamp: int, inputs: FloatArray, measured: float) -> None:
        """Step the twin by one sample; see `Twin.step`."""
        twin = self.twin
        prediction = twin.step(stamp, inputs, measured)
        if prediction == prediction:   # not nan
            self._prediction(self._writer.write(stamp, prediction))
            if twin.residual == twin.residual:
                self._residual(self._writer.write(stamp, twin.residual))
