"""Rprop for many networks of one shape at once, and the gradient of an MLP, in torch."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from hydro_twin.arrays import FloatArray

ETA_PLUS, ETA_MINUS = 1.2, 0.5                         # Riedmiller and Braun 1993
INITIAL_STEP, MIN_STEP, MAX_STEP = 0.01, 1e-6, 50.0    # of a weight

# (weights (B, P), where the gradient goes (B, P)) -> sum of squares of every network (B,)
Gradient = Callable[[Tensor, Tensor], Tensor]
# weights (B, P) -> sum of squares of every network over patterns that do not train (B,)
HeldOutError = Callable[[Tensor], Tensor]


def computes_on(device: str) -> bool:
    """Try whether torch can compute on a device, 'cpu' or such as 'cuda'."""
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError):
        return False
    return True


def layers(weights: Tensor, sizes: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
    """View flat weights, shape (B, P), as matrices (B, in, out) and biases (B, 1, out)."""
    views, begin = [], 0
    for rows, columns in pairwise(sizes):
        bias = begin + rows * columns
        views.append((weights[:, begin:bias].view(-1, rows, columns),
                      weights[:, bias:bias + columns].view(-1, 1, columns)))
        begin = bias + columns
    return views


def gradient(
    weights: Tensor, sizes: Sequence[int], x: Tensor, y: Tensor, decay: float, out: Tensor,
    bounded: bool = False,
) -> Tensor:
    """Differentiate the sum over the patterns of e^2 / 2, plus decay/2 times that of weights^2.

    Written out rather than left to autograd, which costs a fifth more time.

    Args:
        weights: shape (B, P).
        sizes: widths of the layers.
        x: shape (B, N, R).
        y: shape (B, N, 1).
        decay: weight decay.
        out: takes the gradient, shape (B, P).
        bounded: the output too goes through a tanh.

    Returns:
        Sum of e^2 of every network, shape (B,).
    """
    here, there = layers(weights, sizes), layers(out, sizes)
    activations = [x]
    for matrix, bias in here[:-1]:
        activations.append(torch.baddbmm(bias, activations[-1], matrix).tanh_())
    output = torch.baddbmm(here[-1][1], activations[-1], here[-1][0])
    if bounded:
        output.tanh_()
    error = output - y
    squares = error.square().sum((1, 2))
    if bounded:
        error.mul_(output.square_().neg_().add_(1.0))
    for i in reversed(range(len(here))):
        matrix_gradient, bias_gradient = there[i]
        matrix_gradient.copy_(activations[i].transpose(1, 2) @ error)
        bias_gradient.copy_(error.sum(1, keepdim=True))
        if i:
            slope = activations[i].square().neg_().add_(1.0)
            error = (error @ here[i][0].transpose(1, 2)).mul_(slope)
    out.add_(weights, alpha=decay)
    return squares


def squares(weights: Tensor, sizes: Sequence[int], x: Tensor, y: Tensor) -> Tensor:
    """Sum e^2 of every network over patterns, as `gradient` does, shape (B,)."""
    here = layers(weights, sizes)
    layer = x
    for matrix, bias in here[:-1]:
        layer = torch.baddbmm(bias, layer, matrix).tanh_()
    error = torch.baddbmm(here[-1][1], layer, here[-1][0]).sub_(y)
    return error.square_().sum((1, 2))


def rprop(weights: Tensor, gradient: Tensor, previous: Tensor, steps: Tensor) -> None:
    """Move every weight by its own step against its gradient; all of one shape, in place.

    A step grows while the sign of the gradient stays and shrinks when it turns, and then the
    weight rests once. `torch.optim.Rprop` gives the same digits, and an epoch of one network on a
    processor then takes longer (benchmarks/networks.py).
    """
    turn = torch.mul(gradient, previous).sign_()
    steps.copy_(torch.where(turn > 0, steps * ETA_PLUS,
                            torch.where(turn < 0, steps * ETA_MINUS, steps)))
    steps.clamp_(MIN_STEP, MAX_STEP)
    gradient.masked_fill_(turn < 0, 0.0)
    weights.addcmul_(gradient.sign(), steps, value=-1.0)
    previous.copy_(gradient)


def train(
    gradient_of: Gradient, weights: FloatArray, epochs: int, device: str,
    epoch_done: Callable[[], object], held_out: HeldOutError | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Train every network for a number of epochs, each on all its patterns at once.

    In single precision: double takes 1.7 times as long, and ends no lower. On one thread of a
    processor: more of them gain little on one network, and lose where several are trained.

    Args:
        gradient_of: gives the sum of squares of each network's weights, and their gradient.
        weights: where to start, shape (B, P).
        epochs: number of steps.
        device: a torch device, 'cpu' or 'cuda'.
        epoch_done: called after every epoch.
        held_out: gives the sum of squares over other patterns, which do not train.

    Returns:
        The weights, shape (B, P), and the sums of squares before each epoch, shape (B, epochs),
        of the patterns and of those held out; the latter are nan where none are.
    """
    threads = torch.get_num_threads()
    trained = as_tensor(weights, device).clone()
    gradient, previous = torch.empty_like(trained), torch.zeros_like(trained)
    steps = torch.full_like(trained, INITIAL_STEP)
    learning_curve, held_out_curve = [], []
    torch.set_num_threads(1)
    try:
        for _ in range(epochs):
            if held_out is not None:
                held_out_curve.append(held_out(trained))
            learning_curve.append(gradient_of(trained, gradient))
            rprop(trained, gradient, previous, steps)
            epoch_done()
    finally:
        torch.set_num_threads(threads)

    def stack(sums: Sequence[Tensor]) -> FloatArray:
        if not sums:
            return np.full((len(weights), epochs), np.nan)
        return torch.stack(list(sums), 1).cpu().numpy().astype(np.float64)

    return (trained.cpu().numpy().astype(np.float64), stack(learning_curve),
            stack(held_out_curve))


def as_tensor(array: FloatArray, device: str) -> Tensor:
    """Move an array to a device, in single precision."""
    return torch.as_tensor(array, dtype=torch.float32, device=device)
