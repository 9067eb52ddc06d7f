"""The observer: an extended Kalman filter about a model with its effects, in square-root form.

The states of the plant and what the effects keep are filtered together. A prediction moves them by
the compiled step, and the root S of their covariance, P = S S', by the derivatives of the same
step; process noise is added and S made triangular again by reflections [Kaminski et al. 1971]. A
measurement updates both by Potter's formula [Bierman 1977, II.3]. So P is symmetric and positive
semidefinite whatever the rounding, and with process noise definite in the states.
"""
from __future__ import annotations

import math
from typing import NamedTuple, TYPE_CHECKING

import numpy as np
from scipy.linalg import expm

from hydro_twin.compiled import compiled
from hydro_twin.plants.plant import FloatArray, Laws
from hydro_twin.predictors import sensitivities
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.predictors.rows import WIDTH
from hydro_twin.predictors.sensitivities import NONE, partials, Rows, rows_for, tangent_of
from hydro_twin.predictors.system import System

if TYPE_CHECKING:
    from hydro_twin.model import Noise

# A predicted output this many times as uncertain as the plant's largest says nothing any more: the
# covariance begins anew. It bounds what grows while nothing is measured.
USELESS = 1e3


class Filter(NamedTuple):
    """What the observer needs beside the step, for n states, N with the memory.

    Attributes:
        start: root of the covariance at the start, (N, C) with C >= N + n columns.
        process: root of the covariance that a sample adds to the states, (n, n).
        variance: of the measurement noise.
        most: standard deviation of the predicted output beyond which the covariance begins anew.
    """

    start: FloatArray
    process: FloatArray
    variance: float
    most: float


class Scratch(NamedTuple):
    """What `run` works in.

    Attributes:
        S: root of the covariance of states and memory, (N, C).
        rows: derivatives, of which those of states and memory are views of S.
        work: of the kernel.
        g: partial derivatives of a law.
        v: a row of S.
    """

    S: FloatArray
    rows: Rows
    work: FloatArray
    g: FloatArray
    v: FloatArray


@compiled
def triangularise(S, columns, v):  # type: ignore[no-untyped-def]
    """Make S lower triangular by reflections of its columns, which leave S S' as it is."""
    N = len(S)
    for i in range(N):
        square = 0.0
        for c in range(i, columns):
            v[c] = S[i, c]
            square += v[c] * v[c]
        if square == 0.0:
            continue
        norm = -math.copysign(math.sqrt(square), v[i])
        v[i] -= norm
        scale = 1.0 / (square - norm * S[i, i])
        S[i, i] = norm
        for c in range(i + 1, columns):
            S[i, c] = 0.0
        for j in range(i + 1, N):
            along = 0.0
            for c in range(i, columns):
                along += S[j, c] * v[c]
            along *= scale
            for c in range(i, columns):
                S[j, c] -= along * v[c]


@compiled
def run(  # type: ignore[no-untyped-def]
        step, tangent, filter_, scratch, x, z, inputs, measured, begin, end, results, states):
    """Predict each sample from begin to end, and take in what is measured there, if anything.

    Moves x, z and the root of their covariance. results (M, 2) gets the prediction and the
    variance of the innovation; states (M, 2, n), if not empty, the states after the measurement
    and their standard deviations. A run that diverges is left at nan from there on.
    """
    S, rows, work, g, v = scratch
    n, N = len(x), len(S)
    used = N + n + len(step.effects)
    slope = v[:used]
    for k in range(begin, end):
        if k > 0:
            sensitivities.advance(step, tangent, x, z, work, rows, g, inputs, k)
            for i in range(n):
                for j in range(n):
                    S[i, N + j] = filter_.process[i, j]
            triangularise(S, used, v)
        y = sensitivities.output(step, tangent, x, z, work, rows, g, inputs, k, slope)
        if not abs(y) < LIMIT:
            results[k:end] = float('nan')
            states[k:end] = float('nan')
            return
        noise = filter_.variance
        for j in range(N, used):
            noise += slope[j] * slope[j]
        variance = noise
        for j in range(N):
            variance += slope[j] * slope[j]
        known = variance <= filter_.most * filter_.most
        if not known:
            variance = filter_.most * filter_.most
            for i in range(N):
                for j in range(S.shape[1]):
                    S[i, j] = filter_.start[i, j]
        results[k, 0], results[k, 1] = y, variance
        innovation = measured[k] - y
        if known and innovation == innovation:
            shrink = 1.0 / (variance + math.sqrt(noise * variance))
            for i in range(N):
                covariance = 0.0
                for j in range(N):
                    covariance += S[i, j] * slope[j]
                if i < n:
                    x[i] += covariance / variance * innovation
                else:
                    z[i - n] += covariance / variance * innovation
                for j in range(N):
                    S[i, j] -= shrink * covariance * slope[j]
        if len(states) > 0:
            for i in range(n):
                square = 0.0
                for j in range(N):
                    square += S[i, j] * S[i, j]
                states[k, 0, i], states[k, 1, i] = x[i], math.sqrt(square)


class Observer:
    """A system with its noise, as `run` takes them."""

    def __init__(self, system: System, noise: Noise) -> None:
        """Discretise the noise, and differentiate the step by states and memory."""
        self.system = system
        n, N = len(system.laws.A), len(system.laws.A) + system.memory
        names = system.plant.states
        process = process_root(system.laws, system.step.sample_time,
                               np.array([noise.process.get(name, 0.0) for name in names]))
        blocks = math.ceil((N + n + len(system.step.effects)) / WIDTH)
        start = np.zeros((N, blocks * WIDTH))
        start[range(n), range(n)] = [noise.start[name] for name in names]
        self.filter = Filter(start, process, noise.measurement ** 2,
                             USELESS * system.plant.output_scale)
        self.filters = tuple(
            (stage.step, tangent_of(stage, NONE)._replace(rest=N + n), self.filter)
            for stage in system.stages)

    def scratch(self) -> Scratch:
        """Allocate what `run` works in, with the covariance of the start."""
        n, S = len(self.system.laws.A), self.filter.start.copy()
        blocks = S.reshape(len(S), -1, WIDTH)
        rows = rows_for(self.system, blocks.shape[1])._replace(X=blocks[:n], Z=blocks[n:])
        return Scratch(S, rows, self.system.work(), partials(self.system), np.zeros(S.shape[1]))

    def run(self, inputs: FloatArray, measured: FloatArray, states: bool = False,
            start: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Observe a series.

        Args:
            inputs: (M, m).
            measured: the output, nan where there is none, (M,).
            states: whether those are wanted.
            start: stamp of the first sample [ns]; None stands for now.

        Returns:
            Prediction and variance of the innovation, (M, 2), and, if wanted, the states after
            each measurement and their standard deviations, (M, 2, n); nan after a divergence.
        """
        system = self.system
        x = system.at(start).start(inputs[0],
                                   measured[0] if math.isfinite(measured[0]) else 0.0)
        z, scratch = np.zeros(system.memory), self.scratch()
        results = np.empty((len(inputs), 2))
        seen = np.empty((len(inputs) if states else 0, 2, len(x)))
        for k, first, last in system.stretches(len(inputs), start):
            run(*self.filters[k], scratch, x, z, inputs, measured, first, last, results, seen)
        return results, seen


def process_root(laws: Laws, T: float, intensity: FloatArray) -> FloatArray:
    """Integrate white noise on the rates of the states over a sample; a root of its covariance.

    Args:
        laws: the linear laws.
        T: the sample time [s].
        intensity: of the noise on each rate, (n,), in units of the state over sqrt(s).

    Returns:
        (n, n), lower triangular [Van Loan 1978].
    """
    n = len(laws.A)
    fastest = float(np.abs(np.linalg.eigvals(laws.A)).max())
    halvings = max(0, math.ceil(math.log2(max(fastest * T, 1e-9))) + 1)
    h = T / 2 ** halvings
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -laws.A, np.diag(intensity ** 2), laws.A.T
    exponential = expm(block * h)
    Phi = exponential[n:, n:].T
    covariance = Phi @ exponential[:n, n:]
    scale = np.sqrt(np.diag(covariance))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    for _ in range(halvings):
        root = np.linalg.qr(np.hstack([root, Phi @ root]).T)[1].T
        Phi = Phi @ Phi
    return np.ascontiguousarray(root)
