"""The two networks that [L18] compares its own with: radial basis functions, and plain BP."""
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial.distance import cdist, pdist
from scipy.special import expit

from hydro_twin.arrays import FloatArray

Network = Callable[[FloatArray], FloatArray]

CENTRES = 60
HIDDEN = 10
EPOCHS = 5000
RATE, MOMENTUM = 0.05, 0.9


def train_rbf(X: FloatArray, y: FloatArray, rng: np.random.Generator) -> Network:
    """Train a network of Gaussian units: centres by k-means, output weights by least squares.

    Args:
        X: inputs, shape (samples, inputs), scaled.
        y: target, shape (samples,), scaled.
        rng: draws the first centres.

    Returns:
        The network, from inputs to outputs.
    """
    centres, _ = kmeans2(X, CENTRES, minit='++', seed=rng)
    width = np.median(pdist(centres))

    def hidden(inputs: FloatArray) -> FloatArray:
        units = np.exp(-cdist(inputs, centres, 'sqeuclidean') / (2 * width**2))
        return np.column_stack([units, np.ones(len(inputs))])

    weights = np.linalg.lstsq(hidden(X), y, rcond=None)[0]
    return lambda inputs: np.asarray(hidden(inputs) @ weights)


def train_bp(X: FloatArray, y: FloatArray, rng: np.random.Generator) -> Network:
    """Train one hidden layer of logistic units by back-propagation: batch descent, momentum.

    Args:
        X: inputs, shape (samples, inputs), scaled.
        y: target, shape (samples,), scaled.
        rng: draws the starting weights.

    Returns:
        The network, from inputs to outputs.
    """
    def extended(inputs: FloatArray) -> FloatArray:
        return np.column_stack([inputs, np.ones(len(inputs))])

    W = rng.uniform(-0.5, 0.5, (X.shape[1] + 1, HIDDEN))
    w = rng.uniform(-0.5, 0.5, HIDDEN + 1)
    step_W, step_w = np.zeros_like(W), np.zeros_like(w)
    inputs = extended(X)
    for _ in range(EPOCHS):
        hidden = expit(inputs @ W)
        error = extended(hidden) @ w - y
        back = np.outer(error, w[:-1]) * hidden * (1 - hidden)
        step_w = MOMENTUM * step_w - RATE * extended(hidden).T @ error / len(y)
        step_W = MOMENTUM * step_W - RATE * inputs.T @ back / len(y)
        w, W = w + step_w, W + step_W
    return lambda given: np.asarray(extended(expit(extended(given) @ W)) @ w)
