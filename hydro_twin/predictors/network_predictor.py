"""The predictor with a network: MLP or GRU, or beside the analytical model (hybrid)."""
from __future__ import annotations

from itertools import count
import json
import logging
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from safetensors import safe_open, SafetensorError

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import ModelError
from hydro_twin.predictors.analytical import Analytical, OneStep
from hydro_twin.predictors.network import FORMAT, Network
from hydro_twin.predictors.recurrent import Recurrent
from hydro_twin.predictors.registry import kind_named
from hydro_twin.recording.series import Series

if TYPE_CHECKING:
    from hydro_twin.model import Model

log = logging.getLogger(__name__)

CELLS: dict[str, type[Network]] = {kind.cell: kind for kind in (Network, Recurrent)}


class NetworkPredictor:
    """Runs a network on the regressors of [B19], y(k-1..k-n) and u(k..k-n) of every input.

    The MLP and the GRU give the output; the GRU has a state beside, zero at the first sample
    with all regressors. The hybrid's network gives what the one-step prediction of the analytical
    model lacks. In a free run the output is fed back, to the network and to the analytical model
    alike; it starts from rest at the first measured output.
    """

    def __init__(self, model: Model, network: Network) -> None:
        """Join a model and the network that belongs to it.

        Raises:
            ModelError: the network is of another kind than the model says, or takes another
                number of regressors than the plant has.
        """
        self.model, self.network, self.plant = model, network, model.plant
        self.sample_time = model.sample_time
        kind = kind_named(model.kind)
        self.analytical = Analytical(model) if kind.physics else None
        order = self.plant.order
        wanted = order + (order + 1) * len(self.plant.inputs)
        if kind.network is None or network.cell != kind.network.cell:
            raise ModelError(f'a model of kind {model.kind} has no {network.cell} network')
        if network.sizes[0] != wanted:
            raise ModelError(f'the network takes {network.sizes[0]} regressors, but '
                             f'{self.plant.name} has {wanted}')

    def stepper(self, mode: str) -> NetworkStepper:
        """Start a live run; see `Predictor`."""
        return NetworkStepper(self, mode)

    def one_step(self, series: Series) -> FloatArray:
        """Predict each sample from measured outputs up to the one before; see `Predictor`."""
        return self._run('one_step', series)

    def free_run(self, series: Series) -> FloatArray:
        """Predict each sample with no measured output used after the first; see `Predictor`.

        A run that leaves the range that its network knows is nan from there on, and logged.
        """
        prediction = self._run('free_run', series)
        if (lost := np.isnan(prediction)).any():
            log.warning('%s: the free run of the network diverges after %.3f s',
                        series.source or 'series', np.argmax(lost) * self.sample_time)
        return prediction

    def _run(self, mode: str, series: Series) -> FloatArray:
        stepper = self.stepper(mode)
        inputs = np.column_stack([series[signal.name] for signal in self.plant.inputs])
        measured = series[self.plant.output.name].tolist()
        stamps = count(series.start, round(1e9 * series.sample_time))
        return np.array([stepper.step(u, y, stamp) for u, y, stamp in zip(
            inputs, measured, stamps, strict=False)])


class NetworkStepper:
    """A network at one instant of a run."""

    def __init__(self, predictor: NetworkPredictor, mode: str) -> None:
        self.network, self.scratch = predictor.network, predictor.network.scratch()
        self.analytical = OneStep(predictor.analytical) if predictor.analytical else None
        self.free, self.count = mode == 'free_run', 0
        self.order = predictor.plant.order
        self.regressors = np.full(predictor.network.sizes[0], np.nan)
        self.past_outputs = self.regressors[:self.order]
        self.past_inputs = self.regressors[self.order:].reshape(-1, self.order + 1)

    def step(self, inputs: FloatArray, measured: float, stamp: int | None = None,
             sensors: FloatArray | None = None) -> float:   # noqa: ARG002
        """Predict the output of the next sample; see `Stepper`."""
        if self.free:
            if self.count == 0:
                self._rest(inputs, measured if math.isfinite(measured) else 0.0, stamp)
            measured = math.nan
        self.past_inputs[:, 1:] = self.past_inputs[:, :-1]
        self.past_inputs[:, 0] = inputs
        output = self.network.predict(self.regressors, self.scratch)
        if self.analytical is not None:
            base = self.analytical.step(inputs, measured, stamp)
            if math.isnan(measured) and self.count >= self.order:
                self.analytical.past[self.analytical.k] += output   # what the hybrid adds to it
            output += base
        if self.free and not abs(output) <= self.network.limit:
            output = math.nan
        if math.isfinite(measured):
            known = measured
        else:       # as in the analytical model: not measured counts as predicted
            known = output if self.count >= self.order else 0.0
        self.past_outputs[1:] = self.past_outputs[:-1]
        self.past_outputs[0] = known
        self.count += 1
        return output

    def _rest(self, inputs: FloatArray, output: float, stamp: int | None) -> None:
        """Set a past in which nothing moved."""
        self.past_inputs[:] = inputs[:, None]
        self.past_outputs[:] = output
        self.count = self.order
        self.network.settle(self.regressors, self.scratch)
        if self.analytical is not None:
            for _ in range(self.order):
                self.analytical.step(inputs, output, stamp)


def load_network_predictor(model: Model, folder: Path) -> NetworkPredictor:
    """Make the predictor of a model with a network; its weights lie in the folder.

    Raises:
        ModelError: the model names no weights, or they are missing, damaged or of another plant.
    """
    if not model.network:
        raise ModelError(f'a model of kind {model.kind} must name its network')
    return NetworkPredictor(model, load_network(folder / model.network))


def load_network(path: Path) -> Network:
    """Read a network from a file of `network_bytes`.

    Raises:
        ModelError: the file is missing, damaged, of another format, or does not fit together.
    """
    try:
        with safe_open(path, framework='numpy') as file:
            metadata = file.metadata() or {}
            names = file.keys()
            tensors = {name: file.get_tensor(name).astype(float) for name in names}
        if metadata.get('format') != FORMAT:
            raise ModelError(f'format {metadata.get("format")}, expected {FORMAT}')
        made = CELLS[metadata['activation']]
        return made(np.array(json.loads(metadata['sizes']), dtype=np.int64),
                    tensors['weights'], tensors['input_shift'], tensors['input_scale'],
                    tensors['output_scale'].item(), tensors['output_limit'].item())
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, ModelError) as error:
        raise ModelError(f'{path}: not a network of this software: {error}') from error
