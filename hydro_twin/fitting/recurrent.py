"""Training of a GRU in torch: on windows of the stretches, by backpropagation through time."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from hydro_twin.arrays import FloatArray
from hydro_twin.predictors.recurrent import SETTLED

WINDOW = SETTLED        # patterns in a window
WARM = 10               # of them only bring up the state, but for the first window of a stretch


def windows(lengths: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Cut stretches of patterns into windows, so that every pattern is scored once.

    Args:
        lengths: patterns of each stretch; the stretches lie one after the other.

    Returns:
        Rows of the patterns, shape (W, WINDOW), and which of them are scored.
    """
    rows, scored = [], []
    begin = 0
    for length in lengths:
        for first in range(0, max(length - WARM, 1), WINDOW - WARM):
            k = first + np.arange(WINDOW)
            rows.append(begin + np.minimum(k, length - 1))
            scored.append((k < length) & ((k >= first + WARM) | (first == 0)))
        begin += length
    return np.array(rows), np.array(scored)


def initial_weights(sizes: Sequence[int], seed: int) -> FloatArray:
    """Draw the weights of a fresh GRU from +-1/sqrt(units)."""
    R, H, _ = sizes
    count = 3 * H * (R + H + 1) + H + 1
    drawn: FloatArray = np.random.default_rng(seed).uniform(-1.0, 1.0, count) / np.sqrt(H)
    return drawn


def squares(
    weights: Tensor, sizes: Sequence[int], x: Tensor, y: Tensor, scored: Tensor,
) -> Tensor:
    """Sum e^2 of every network over the scored patterns, shape (B,).

    Args:
        weights: shape (B, P), in the order of `predictors.recurrent.advance`.
        sizes: (R, H, 1).
        x: scaled regressors, shape (W, L, R).
        y: scaled targets, shape (W, L).
        scored: 1 for patterns that count, 0 for the others, shape (W, L).
    """
    R, H, _ = sizes
    W, U, U_n, b, out, bias = torch.split(
        weights, [R * 3 * H, 2 * H * H, H * H, 3 * H, H, 1], dim=1)
    nets, (count, length) = len(weights), y.shape
    U, U_n = U.reshape(nets, H, 2 * H), U_n.reshape(nets, H, H)
    driven = torch.baddbmm(b[:, None, :], x.reshape(1, -1, R).expand(nets, -1, -1),
                           W.reshape(nets, R, 3 * H)).view(nets, count, length, 3 * H)
    h = weights.new_zeros(nets, count, H)
    states = []
    for k in range(length):
        gates, new = torch.split(driven[:, :, k], [2 * H, H], dim=2)
        z, r = torch.split(torch.baddbmm(gates, h, U).sigmoid(), H, dim=2)
        h = torch.lerp(torch.baddbmm(new, r * h, U_n).tanh(), h, z)
        states.append(h)
    output = torch.stack(states, 2) @ out[:, None, :, None]
    error = (output[..., 0] + bias[:, :, None] - y) * scored
    return error.square().sum((1, 2))


def gradient(
    weights: Tensor, sizes: Sequence[int], x: Tensor, y: Tensor, scored: Tensor, decay: float,
    out: Tensor,
) -> Tensor:
    """Differentiate as `rprop.gradient` does; the arguments are those of `squares`."""
    moved = weights.detach().requires_grad_()
    sums = squares(moved, sizes, x, y, scored)
    out.copy_(torch.autograd.grad(0.5 * sums.sum(), moved)[0]).add_(weights, alpha=decay)
    return sums.detach()
