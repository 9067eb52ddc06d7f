"""Prediction of a trained network, without torch: one compiled arithmetic, live and in replay."""
from __future__ import annotations

from dataclasses import dataclass
import json
import math

import numpy as np
from safetensors.numpy import save

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled
from hydro_twin.errors import ModelError

FORMAT = '1'


@compiled
def forward(  # type: ignore[no-untyped-def]
        sizes, weights, shift, scale, output_scale, regressors, layers):
    """Compute the output of one sample, the sums always in the same order.

    A matrix product would round a batch otherwise than a single sample; this does not.

    Args:
        sizes: width of every layer, inputs first, shape (L,).
        weights: layer after layer the matrix (in, out) by rows, then the bias, shape (P,).
        shift: of the regressors, shape (R,).
        scale: the net sees (regressors - shift) / scale, shape (R,).
        output_scale: the net gives the output over this.
        regressors: shape (R,).
        layers: scratch, shape (2, widest layer).
    """
    here, there = layers[0], layers[1]
    for i in range(sizes[0]):
        here[i] = (regressors[i] - shift[i]) / scale[i]
    begin = 0
    for layer in range(len(sizes) - 1):
        rows, columns = sizes[layer], sizes[layer + 1]
        bias = begin + rows * columns
        for j in range(columns):
            there[j] = weights[bias + j]
        for i in range(rows):
            value, row = here[i], weights[begin + i * columns:begin + (i + 1) * columns]
            for j in range(columns):
                there[j] += value * row[j]
        if layer < len(sizes) - 2:
            for j in range(columns):
                there[j] = math.tanh(there[j])
        begin = bias + columns
        here, there = there, here
    return output_scale * here[0]


@compiled
def forward_all(  # type: ignore[no-untyped-def]
        sizes, weights, shift, scale, output_scale, regressors, layers, outputs):
    """Compute `forward` for every row of regressors, shape (N, R), into outputs, shape (N,)."""
    for k in range(len(regressors)):
        outputs[k] = forward(sizes, weights, shift, scale, output_scale, regressors[k], layers)


@dataclass(frozen=True, eq=False)
class Network:
    """A trained multi-layer perceptron: tanh layers, then a linear output.

    Attributes:
        sizes: width of every layer, regressors first, the single output last, shape (L,).
        weights: layer after layer the matrix (in, out) by rows, then the bias, shape (P,).
        shift, scale: the net sees (regressors - shift) / scale, shape (R,).
        output_scale: unit of the output, in that of the plant.
        limit: a free run beyond this size has diverged, in the output's unit.
    """

    sizes: IntArray
    weights: FloatArray
    shift: FloatArray
    scale: FloatArray
    output_scale: float
    limit: float

    cell = 'tanh'

    def __post_init__(self) -> None:
        """Refuse what does not fit together.

        Raises:
            ModelError: shapes that do not agree, or values that are not finite.
        """
        sizes = self.sizes
        if len(sizes) < 2 or np.any(sizes < 1) or sizes[-1] != 1:
            raise ModelError(f'a network of layers {sizes.tolist()} has not one output')
        if self.weights.shape != (self.count(sizes),):
            raise ModelError(f'{self.weights.size} weights do not make layers {sizes.tolist()}')
        if self.shift.shape != (sizes[0],) or self.scale.shape != (sizes[0],):
            raise ModelError(f'the scaling is not that of {sizes[0]} regressors')
        numbers = np.concatenate([self.weights, self.shift, self.scale, [self.output_scale]])
        if not np.all(np.isfinite(numbers)) or np.any(self.scale <= 0) or not self.limit > 0:
            raise ModelError('the network holds values that are not finite, or scales not above 0')

    @staticmethod
    def count(sizes: IntArray) -> int:
        """Count the weights of layers of these widths."""
        return int(np.sum((sizes[:-1] + 1) * sizes[1:]))

    def scratch(self) -> FloatArray:
        """Return the scratch for the layers of one sample, for `predict`."""
        return np.empty((2, int(self.sizes.max())))

    def predict(self, regressors: FloatArray, scratch: FloatArray) -> float:
        """Predict one sample from its regressors, shape (R,), in the plant's units."""
        return float(forward(self.sizes, self.weights, self.shift, self.scale, self.output_scale,
                             regressors, scratch))

    def settle(self, regressors: FloatArray, scratch: FloatArray) -> None:
        """Come to rest under regressors that do not change: nothing is kept, nothing to do."""

    def __call__(self, regressors: FloatArray) -> FloatArray:
        """Predict every row of regressors, shape (N, R) -> (N,), in the plant's units."""
        outputs = np.empty(len(regressors))
        forward_all(self.sizes, self.weights, self.shift, self.scale, self.output_scale,
                    np.ascontiguousarray(regressors), self.scratch(), outputs)
        return outputs


def network_bytes(network: Network) -> bytes:
    """Return the content of the .safetensors file of a network."""
    tensors = {'weights': network.weights, 'input_shift': network.shift,
               'input_scale': network.scale, 'output_scale': np.array([network.output_scale]),
               'output_limit': np.array([network.limit])}
    metadata = {'format': FORMAT, 'sizes': json.dumps(network.sizes.tolist()),
                'activation': network.cell}
    content: bytes = save(tensors, metadata)
    return content
