"""The observer: a Kalman filter about a model with its effects, in square-root form.

The states of the plant, what the effects keep and the parameters that are followed are filtered
together. A prediction moves them by the compiled step, and the root S of their covariance,
P = S S', by the derivatives of the same step, in which each law is made linear over what is not
known of its input; process noise is added and S made triangular again by reflections [Kaminski et
al. 1971]. A measurement updates both by Potter's formula [Bierman 1977, II.3]. So P is symmetric
and positive semidefinite whatever the rounding, and with process noise definite in the states.
"""
from __future__ import annotations

import math
from typing import NamedTuple, TYPE_CHECKING

import numpy as np
from scipy.linalg import expm

from hydro_twin.compiled import compiled
from hydro_twin.plants.plant import FloatArray, Laws
from hydro_twin.predictors.follow import follow_by, Followed
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.predictors.quantities import quantities_of
from hydro_twin.predictors.rows import in_rows, WIDTH
from hydro_twin.predictors.step_derivatives import (
    advance,
    divided,
    output,
    partials,
    room_for,
)
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import NONE, tangent_of

if TYPE_CHECKING:
    from hydro_twin.model import Noise

# A predicted output this many times as uncertain as the plant's largest says nothing any more: the
# covariance begins anew. It bounds what grows while nothing is measured.
USELESS = 1e3
UNWANTED = np.empty((0, 0))     # gains that nobody asks for


class Filter(NamedTuple):
    """What the observer needs beside the step, for n states, N with memory and parameters.

    Attributes:
        start: root of the covariance at the start, (N, C) with room for `used` columns.
        process: root of the covariance that a sample adds to the states, (n, n).
        walks: standard deviation by which a sample moves each parameter that is followed, (Q,).
        used: columns at work: N, those of the process noise, and one for each law.
        variance: of the measurement noise.
        most: standard deviation of the predicted output beyond which the covariance begins anew.
        shown: what is estimated beside the prediction, as sums of states, memory and parameters,
            then inputs and what effects add to the ports, (R, N + m + P).
    """

    start: FloatArray
    process: FloatArray
    walks: FloatArray
    used: int
    variance: float
    most: float
    shown: FloatArray


class Scratch(NamedTuple):
    """What `run` works in.

    Attributes:
        S: root of the covariance of states, memory and parameters, (N, C).
        blocks: the same as rows of derivatives.
        room: for the other rows of a step.
        work: of the kernel.
        g: partial derivatives of a law.
        v: a row of S.
    """

    S: FloatArray
    blocks: FloatArray
    room: FloatArray
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
def show(shown, S, x, z, q, u, d, v, estimate):  # type: ignore[no-untyped-def]
    """Write sums of what is known, and their standard deviations, into estimate (2, R)."""
    n, w, N, m = len(x), len(z), len(S), len(u)
    for r in range(len(shown)):
        value = square = 0.0
        for c in range(N):
            v[c] = 0.0
        for i in range(N):
            weight = shown[r, i]
            if weight != 0.0:
                value += weight * (x[i] if i < n else z[i - n] if i < n + w else q[i - n - w])
                for c in range(N):
                    v[c] += weight * S[i, c]
        for i in range(m):
            value += shown[r, N + i] * u[i]
        for i in range(len(d)):
            value += shown[r, N + m + i] * d[i]
        for c in range(N):
            square += v[c] * v[c]
        estimate[0, r], estimate[1, r] = value, math.sqrt(square)


@compiled
def run(  # type: ignore[no-untyped-def]
        step, tangent, filter_, scratch, slow, x, z, inputs, measured, begin, end, results,
        estimates, gains):
    """Predict each sample from begin to end, and take in what is measured there, if anything.

    Moves x, z, the parameters that are followed, and the root of their covariance. results (M, 2)
    gets the prediction and the variance of the innovation; estimates (M, 2, R), if not empty, what
    is known after the measurement, and its standard deviation; gains (M, n + memory), if not
    empty, by how much of the innovation state and memory moved. A run that diverges is left at nan
    from there on. slow is None where no parameter is followed: that is compiled by itself, since
    to pass what is not needed would take as long as the rest. Returns the sample after the last
    one done: it ends early where a parameter has moved so far that the matrices must be made anew.
    """
    S, blocks, room, work, g, v = scratch
    n, N, w, used = len(x), len(S), len(z), filter_.used
    m = len(step.shift)
    q = x[:0] if slow is None else slow.now
    P = step.H.shape[1] - n - m
    rows, walking = divided(blocks[:n], blocks[n:n + w], room, m, P), blocks[n + w:]
    slope = v[:used]
    for k in range(begin, end):
        if k > 0:
            if slow is not None:
                follow_by(step, tangent, slow, walking)
            advance(step, tangent, x, z, work, rows, g, inputs, k)
            for i in range(n):
                for j in range(n):
                    S[i, N + j] = filter_.process[i, j]
            for i in range(len(q)):
                S[n + w + i, N + n + i] = filter_.walks[i]
            triangularise(S, used, v)
        if slow is not None:
            follow_by(step, tangent, slow, walking)
        y = output(step, tangent, x, z, work, rows, g, inputs, k, slope)
        if not abs(y) < LIMIT:
            results[k:end] = float('nan')
            estimates[k:end] = float('nan')
            return end
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
                elif i < n + w:
                    z[i - n] += covariance / variance * innovation
                elif slow is not None:
                    c = i - n - w
                    q[c] = min(max(q[c] + covariance / variance * innovation, slow.low[c]),
                               slow.high[c])
                for j in range(N):
                    S[i, j] -= shrink * covariance * slope[j]
                if len(gains) > 0 and i < n + w:
                    gains[k, i] = covariance / variance
        if len(estimates) > 0:
            show(filter_.shown, S, x, z, q, work[1, :m], work[5, :P], v, estimates[k])
        if slow is not None:
            for i in range(len(q)):
                if abs(q[i] - slow.at[i]) > slow.far[i]:
                    return k + 1
    return end


class Observation:
    """One run of an observer: what it holds between two samples."""

    def __init__(self, observer: Observer, x: FloatArray, z: FloatArray) -> None:
        """Begin with the covariance of the start; state and memory are moved in place."""
        self.observer, self.x, self.z = observer, x, z
        system, blocks = observer.system, in_rows(observer.filter.start)
        S = blocks.reshape(len(blocks), -1)
        self.scratch = Scratch(S, blocks, room_for(system, blocks.shape[1]), system.work(),
                               partials(system), np.zeros(S.shape[1]))
        self.slow = observer.followed.slow() if observer.followed else None
        self.stages = observer.stages
        if observer.followed and self.slow:
            self.stages = (observer.followed.stage(self.slow, observer.columns),)

    def advance(self, stage: int, inputs: FloatArray, measured: FloatArray, first: int, last: int,
                results: FloatArray, estimates: FloatArray, gains: FloatArray = UNWANTED) -> None:
        """Do the samples from first to last, in a stage of the system; see `run`."""
        while first < last:
            first = run(*self.stages[min(stage, len(self.stages) - 1)], self.observer.filter,
                        self.scratch, self.slow, self.x, self.z, inputs, measured, first, last,
                        results, estimates, gains)
            followed, slow = self.observer.followed, self.slow
            if followed and slow and (np.abs(slow.now - slow.at) > slow.far).any():
                self.stages = (followed.stage(slow, self.observer.columns),)

    def copy(self) -> Observation:
        """Copy it, to go on with while this one stays."""
        other = Observation(self.observer, self.x.copy(), self.z.copy())
        other.scratch.S[:] = self.scratch.S
        followed = self.observer.followed
        if followed and self.slow and other.slow:
            other.slow.now[:] = self.slow.now
            other.stages = (followed.stage(other.slow, self.observer.columns),)
        return other


class Observer:
    """A system with its noise, as `run` takes them."""

    def __init__(self, system: System, noise: Noise,
                 followed: Followed | None = None) -> None:
        """Discretise the noise, and differentiate the step by states and memory.

        Args:
            system: what is run.
            noise: what is known of it.
            followed: parameters that go as slow states.
        """
        self.system, self.followed = system, followed
        n, K = len(system.laws.A), len(system.step.effects)
        Q = len(followed.names) if followed else 0
        N, T = n + system.memory + Q, system.step.sample_time
        names = system.plant.states
        process = process_root(system.laws, T,
                               np.array([noise.process.get(name, 0.0) for name in names]))
        used = N + n + Q + K
        start = np.zeros((N, math.ceil(used / WIDTH) * WIDTH))
        start[range(n), range(n)] = [noise.start[name] for name in names]
        slow = range(N - Q, N)
        start[slow, slow] = followed.start if followed else []
        walks = math.sqrt(T) * followed.rate if followed else np.zeros(0)
        self.names, shown = quantities_of(system, N)
        self.columns = used - K
        self.filter = Filter(start, process, walks, used, noise.measurement ** 2,
                             USELESS * system.plant.output_scale,
                             np.vstack([shown, np.eye(N, shown.shape[1])[N - Q:]]))
        self.stages = tuple((stage.step, tangent_of(stage, NONE)._replace(rest=self.columns))
                            for stage in system.stages)

    def run(self, inputs: FloatArray, measured: FloatArray, estimates: bool = False,
            start: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Observe a series.

        Args:
            inputs: (M, m).
            measured: the output, nan where there is none, (M,).
            estimates: whether those are wanted.
            start: stamp of the first sample [ns]; None stands for now.

        Returns:
            Prediction and variance of the innovation, (M, 2), and, if wanted, what is known after
            each measurement and its standard deviation, (M, 2, R): `names`, then the logarithms
            of what is followed over its value in the model; nan after a divergence.
        """
        system = self.system
        x = system.at(start).start(inputs[0],
                                   measured[0] if math.isfinite(measured[0]) else 0.0)
        observation = Observation(self, x, np.zeros(system.memory))
        results = np.empty((len(inputs), 2))
        seen = np.empty((len(inputs) if estimates else 0, 2, len(self.filter.shown)))
        for stage, first, last in system.stretches(len(inputs), start):
            observation.advance(stage, inputs, measured, first, last, results, seen)
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
