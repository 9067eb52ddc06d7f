"""The observer: a Kalman filter about a model with its effects; `kalman` has its compiled step."""
from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm

from hydro_twin.arrays import FloatArray
from hydro_twin.plants.plant import Laws
from hydro_twin.predictors.follow import Followed
from hydro_twin.predictors.kalman import Filter, GATE, NIS_SHARE, run, Scratch
from hydro_twin.predictors.quantities import quantities_of
from hydro_twin.predictors.rows import in_rows, WIDTH
from hydro_twin.predictors.step_derivatives import partials, rows_for
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import NONE, tangent_of

if TYPE_CHECKING:
    from hydro_twin.model import Noise

# The covariance is reset when the standard deviation of the predicted output exceeds this multiple
# of a typical large output. This bounds its growth while nothing is measured.
USELESS = 1e3
UNWANTED = np.empty((0, 0))     # gains that nobody asks for


class Observation:
    """One run of an observer: what it holds between two samples."""

    def __init__(self, observer: Observer, x: FloatArray, z: FloatArray) -> None:
        """Begin with the covariance of the start; state and memory are moved in place."""
        self.observer, self.x, self.z = observer, x, z
        system, blocks = observer.system, in_rows(observer.filter.start)
        S, outputs = blocks.reshape(len(blocks), -1), len(observer.filter.variances)
        room = rows_for(system, blocks.shape[1])[len(system.laws.A) + system.memory:]
        self.scratch = Scratch(S, blocks, room, system.work(), partials(system),
                               np.zeros((1 + outputs, S.shape[1])), np.ones(outputs))
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

    @property
    def believed(self) -> dict[str, bool]:
        """The sensors whose noise is known, and whether each is believed by now; see `kalman`."""
        nis, known = self.scratch.nis, self.observer.filter
        return {sensor.name: bool(nis[k] <= NIS_SHARE * known.gate)
                for k, sensor in enumerate(self.observer.system.plant.sensors, 1)
                if math.isfinite(known.variances[k])}

    def copy(self) -> Observation:
        """Copy it, to go on with while this one stays."""
        other = Observation(self.observer, self.x.copy(), self.z.copy())
        other.scratch.S[:], other.scratch.nis[:] = self.scratch.S, self.scratch.nis
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
        deviations = [noise.measurement, *(noise.sensors.get(sensor.name, math.nan)
                                           for sensor in system.plant.sensors)]
        self.filter = Filter(start, process, walks, used, np.square(deviations), GATE,
                             USELESS * system.plant.output_scale,
                             np.vstack([shown, np.eye(N, shown.shape[1])[N - Q:]]))
        self.stages = tuple((stage.step, tangent_of(stage, NONE)._replace(rest=self.columns))
                            for stage in system.stages)

    def run(self, inputs: FloatArray, measured: FloatArray, estimates: bool = False,
            start: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Observe a series.

        Args:
            inputs: (M, m).
            measured: the output, (M,), or the output and the sensors of the plant, (M, 1 + R); nan
                where there is none.
            estimates: whether those are wanted.
            start: stamp of the first sample [ns]; None stands for now.

        Returns:
            Prediction and variance of the innovation, (M, 2), or of each output in turn,
            (M, 2 + 2R), see `run`; and, if wanted, what is known after each measurement and its
            standard deviation, (M, 2, R): `names`, then the logarithms of what is followed over
            its value in the model; nan after a divergence.
        """
        system, measured = self.system, measured.reshape(len(inputs), -1)
        x = system.at(start).start(inputs[0], float(measured[0, 0]))
        observation = Observation(self, x, np.zeros(system.memory))
        results = np.empty((len(inputs), 2 * measured.shape[1]))
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
