"""What every predictor offers, offline over a series and live sample by sample."""
from __future__ import annotations

from typing import Protocol, TYPE_CHECKING

from hydro_twin.arrays import FloatArray
from hydro_twin.plants import Plant
from hydro_twin.recording.series import Series

if TYPE_CHECKING:
    from hydro_twin.model import Model

MODES = ('one_step', 'free_run')        # of every predictor
OBSERVER = 'observer'                   # of an analytical one that knows its noise


def modes_of(model: Model) -> tuple[str, ...]:
    """List the modes in which a model runs; each is the name of a method of its predictor."""
    return MODES if model.noise is None else (*MODES, OBSERVER)


class Stepper(Protocol):
    """A predictor at one instant of a run; a fresh one is a reset."""

    def step(self, inputs: FloatArray, measured: float, stamp: int | None = None,
             sensors: FloatArray | None = None) -> float:
        """Predict the output of the next sample of the grid.

        Args:
            inputs: of that sample, shape (m,), finite.
            measured: the output measured at that sample, nan where there is none. It serves the
                samples after this one, and the first sample to set the state.
            stamp: of the sample [ns], which matters where a parameter drifts; None stands for now.
            sensors: what the sensors of the plant read at that sample, (R,), nan where that is not
                known; None: none does. The observer takes them in, as the output.

        Returns:
            The prediction, nan while too few samples have passed or after a divergence.
        """
        ...


class Predictor(Protocol):
    """A model that can be run."""

    @property
    def model(self) -> Model:
        """The model that is run."""
        ...

    @property
    def plant(self) -> Plant:
        """The plant it is of."""
        ...

    @property
    def sample_time(self) -> float:
        """Time between two samples [s]."""
        ...

    def one_step(self, series: Series) -> FloatArray:
        """Predict each sample from measured outputs up to the one before; (N,), nan at first."""
        ...

    def free_run(self, series: Series) -> FloatArray:
        """Predict each sample with no measured output used after the first; (N,)."""
        ...

    def stepper(self, mode: str) -> Stepper:
        """Start a live run: until it diverges, it gives the digits of the method of that name."""
        ...
