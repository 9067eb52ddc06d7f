"""Prediction of a trained gated recurrent unit (GRU), compiled; it keeps a state."""
from __future__ import annotations

import math

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled
from hydro_twin.predictors.network import Network

SETTLED = 50            # samples at rest before a free run: the length that it is trained on


@compiled
def advance(  # type: ignore[no-untyped-def]
        sizes, weights, shift, scale, output_scale, regressors, scratch):
    """Take one sample and compute the output, the sums always in the same order.

    With z and r the sigmoids of W x + U h + b, and n = tanh(W x + U (r h) + b), the state h
    becomes z h + (1 - z) n; the output is linear in h (Cho et al. 2014).

    Args:
        sizes: (R, H, 1): regressors, units, outputs.
        weights: W (R, 3H) for z, r and n side by side, by rows; U (H, 2H) for z and r; U (H, H)
            for n; b (3H,); then of the output (H,) and its bias.
        shift: of the regressors, shape (R,).
        scale: the net sees (regressors - shift) / scale, shape (R,).
        output_scale: the net gives the output over this.
        regressors: shape (R,).
        scratch: the state h, shape (H,), in its first row; the rest is scratch, shape (4, H).
    """
    R, H = sizes[0], sizes[1]
    U, U_n = R * 3 * H, R * 3 * H + 2 * H * H
    b = U_n + H * H
    h = scratch[0]
    for j in range(3 * H):
        scratch[1 + j // H, j % H] = weights[b + j]
    for i in range(R):
        value = (regressors[i] - shift[i]) / scale[i]
        for j in range(3 * H):
            scratch[1 + j // H, j % H] += value * weights[i * 3 * H + j]
    for i in range(H):
        for j in range(2 * H):
            scratch[1 + j // H, j % H] += h[i] * weights[U + i * 2 * H + j]
    for j in range(H):
        scratch[1, j] = 1.0 / (1.0 + math.exp(-scratch[1, j]))
        scratch[2, j] = h[j] / (1.0 + math.exp(-scratch[2, j]))
    for i in range(H):
        for j in range(H):
            scratch[3, j] += scratch[2, i] * weights[U_n + i * H + j]
    output = weights[b + 4 * H]
    for j in range(H):
        new = math.tanh(scratch[3, j])
        h[j] = new + scratch[1, j] * (h[j] - new)
        output += h[j] * weights[b + 3 * H + j]
    return output_scale * output


class Recurrent(Network):
    """A trained GRU of one layer, then a linear output; the fields are those of `Network`."""

    cell = 'gru'

    @staticmethod
    def count(sizes: IntArray) -> int:
        """Count the weights of layers of these widths; -1 if there is not one hidden layer."""
        if len(sizes) != 3:
            return -1
        R, H, _ = (int(size) for size in sizes)
        return 3 * H * (R + H + 1) + H + 1

    def scratch(self) -> FloatArray:
        """Return the state at the start of a run, and the scratch of a sample, for `predict`."""
        return np.zeros((4, int(self.sizes[1])))

    def predict(self, regressors: FloatArray, scratch: FloatArray) -> float:
        """Predict one sample and advance the state; at a nan regressor give nan and keep it."""
        if np.isnan(regressors).any():
            return math.nan
        return float(advance(self.sizes, self.weights, self.shift, self.scale, self.output_scale,
                             regressors, scratch))

    def settle(self, regressors: FloatArray, scratch: FloatArray) -> None:
        """Let the state come to rest under regressors that do not change."""
        for _ in range(SETTLED):
            self.predict(regressors, scratch)

    def __call__(self, regressors: FloatArray) -> FloatArray:
        """Predict the rows of one stretch, shape (N, R) -> (N,), one after the other."""
        scratch = self.scratch()
        return np.array([self.predict(row, scratch) for row in regressors])
