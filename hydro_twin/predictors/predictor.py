"""What every predictor offers, offline over a series and live sample by sample."""
from __future__ import annotations

from pathlib import Path
from typing import Protocol

from hydro_twin.errors import ModelError
from hydro_twin.model import Model, read_model
from hydro_twin.plants import Plant
from hydro_twin.plants.plant import FloatArray
from hydro_twin.recording.series import Series

MODES = ('one_step', 'free_run')


class Stepper(Protocol):
    """A predictor at one instant of a run; a fresh one is a reset."""

    def step(self, inputs: FloatArray, measured: float) -> float:
        """Predict the output of the next sample of the grid.

        Args:
            inputs: of that sample, shape (m,), finite.
            measured: the output measured at that sample, nan where there is none. It serves the
                samples after this one, and the first sample to set the state.

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
        """Start a run, live, that gives the very digits of `one_step` or `free_run`."""
        ...


def make_predictor(model: Model, folder: Path) -> Predictor:
    """Make the predictor that a model describes; its network's weights lie in the folder."""
    from hydro_twin.predictors.analytical import Analytical

    if model.kind == 'analytical':
        return Analytical(model)
    from hydro_twin.predictors.hybrid import load_network_predictor

    return load_network_predictor(model, folder)


def load(path: Path, sample_time: float | None = None) -> Predictor:
    """Read a model file and make its predictor.

    Args:
        path: of the model file.
        sample_time: [s] at which it is to run; its own by default.

    Raises:
        ModelError: the file or its weights are missing or cannot be used, or the model has a
            network, which cannot run at that sample time; one line says which.
    """
    model = read_model(path)
    if model.network and not (path.parent / model.network).is_file():
        raise ModelError(f'{path}: its weights file {model.network} is missing: copy it to the '
                         f'folder of the model, {path.parent}')
    if sample_time is not None:
        try:
            model = model.at(sample_time)
        except ModelError as error:
            raise ModelError(f'{path}: {error}') from error
    return make_predictor(model, path.parent)
