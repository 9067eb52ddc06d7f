"""A predictor that is a network: the next output from the last outputs and inputs."""
from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hydro_twin.errors import ModelError
from hydro_twin.plants import Plant
from hydro_twin.predictors.network import FloatArray, Network
from hydro_twin.recording.series import Series

Mode = Literal['one_step', 'free_run']

log = logging.getLogger(__name__)


class Past:
    """The regressors of [B19]: y(k-1..k-n), then u(k..k-n) of every input.

    Attributes:
        regressors: shape (n + (n + 1) m,); NaN where nothing is known yet.
        samples: number of samples that have been taken in.
    """

    def __init__(self, order: int, inputs: int) -> None:
        self.regressors = np.full(order + (order + 1) * inputs, np.nan)
        self.samples = 0
        self._outputs = self.regressors[:order]
        self._inputs = self.regressors[order:].reshape(inputs, order + 1)

    def enter(self, inputs: FloatArray) -> None:
        """Take in the inputs of sample k, shape (m,)."""
        self._inputs[:, 1:] = self._inputs[:, :-1]
        self._inputs[:, 0] = inputs

    def leave(self, output: float) -> None:
        """Take in the output of sample k, measured or predicted."""
        self._outputs[1:] = self._outputs[:-1]
        self._outputs[0] = output
        self.samples += 1


def fed_back(mode: Mode, past: Past, order: int, measured: float, predicted: float) -> float:
    """Choose the output that stands for sample k from now on.

    One step takes the measured one. A free run takes its own, but for its first `order` samples,
    where it has none: these start it, from zero where nothing is measured.
    """
    if mode == 'one_step':
        return measured
    if past.samples >= order:
        return predicted
    return 0.0 if math.isnan(measured) else measured


class Stepper:
    """One sample after another, as they come."""

    def __init__(self, mlp: MLP, mode: Mode) -> None:
        self._network, self._mode, self._order = mlp.network, mode, mlp.plant.order
        self._past = Past(mlp.plant.order, len(mlp.plant.inputs))
        self._scratch = mlp.network.scratch()
        self._limit = mlp.network.limit if mode == 'free_run' else math.inf

    def step(self, inputs: FloatArray, measured: float) -> float:
        """Predict the output of sample k.

        Args:
            inputs: of sample k, shape (m,), in the plant's order and units.
            measured: output of sample k, which only later samples use; NaN where there is none.

        Returns:
            The output, in the plant's unit; NaN for the first `order` samples, which only feed
            the regressors, and for the rest of a free run once it has diverged.
        """
        self._past.enter(inputs)
        output = self._network.predict(self._past.regressors, self._scratch)
        if not abs(output) <= self._limit:
            output = math.nan
        self._past.leave(fed_back(self._mode, self._past, self._order, measured, output))
        return output


@dataclass(frozen=True, eq=False)
class MLP:
    """The multi-layer perceptron of [B19] as a predictor.

    Attributes:
        plant: names the signals, and gives the order.
        network: from the regressors to the output.
    """

    plant: Plant
    network: Network

    def __post_init__(self) -> None:
        """Refuse a network that is not made for the plant."""
        check_regressors(self.plant, self.network)

    def stepper(self, mode: Mode) -> Stepper:
        """Return a predictor of one sample after another."""
        return Stepper(self, mode)

    def one_step(self, series: Series) -> FloatArray:
        """Predict every sample from the measured ones before it, shape (N,)."""
        return run(self.stepper('one_step'), self.plant, series)

    def free_run(self, series: Series) -> FloatArray:
        """Predict every sample from the network's own outputs, shape (N,)."""
        prediction = run(self.stepper('free_run'), self.plant, series)
        say_if_diverged(prediction, self.plant.order, series)
        return prediction


def run(stepper: Stepper, plant: Plant, series: Series) -> FloatArray:
    """Step through a series, as the node does."""
    inputs = np.column_stack([series[signal.name] for signal in plant.inputs])
    pairs = zip(inputs, series[plant.output.name], strict=True)
    return np.array([stepper.step(u, y) for u, y in pairs])


def say_if_diverged(prediction: FloatArray, order: int, series: Series) -> None:
    """Log where a free run left the range that its network knows."""
    if np.isnan(prediction[-1]) and len(prediction) > order:
        first = order + int(np.argmax(np.isnan(prediction[order:])))
        log.warning('%s: the free run of the network diverged at %.3f s',
                    series.source or 'series', first * series.sample_time)


def check_regressors(plant: Plant, network: Network) -> None:
    """Refuse a network that is not made for the plant.

    Raises:
        ModelError: it takes another number of regressors.
    """
    wanted = plant.order + (plant.order + 1) * len(plant.inputs)
    if network.sizes[0] != wanted:
        raise ModelError(f'the network takes {network.sizes[0]} regressors, but '
                         f'{plant.name} has {wanted}')
