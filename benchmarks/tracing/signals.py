"""What drives a rig: commands, the angle of the loaded shaft, and what befalls a command."""
from __future__ import annotations

from collections.abc import Callable
import math

from numba import njit
import numpy as np
import numpy.typing as npt
from scipy.signal import bilinear, chirp, lfilter

FloatArray = npt.NDArray[np.float64]
Generator = np.random.Generator
Motion = Callable[[FloatArray], FloatArray]

EXCITATIONS = ('b19', 'multisine', 'chirp', 'steps')


def command(excitation: str, index: int, time: FloatArray, rng: Generator) -> FloatArray:
    """Draw the command of one series, at most 1 in size.

    Args:
        excitation: one of EXCITATIONS; b19 is a sinusoid of 1, 7 and 9 Hz in turn [B19].
        index: which series of the recording it is.
        time: of every sample [s].
        rng: the source of chance.
    """
    if excitation == 'b19':
        u = np.sin(2 * np.pi * (1.0, 7.0, 9.0)[index % 3] * time)
    elif excitation == 'multisine':
        f = rng.uniform(0.3, 20.0, rng.integers(6, 16))
        u = np.sin(2 * np.pi * np.outer(time, f) + rng.uniform(0, 2 * np.pi, len(f))).sum(axis=1)
    elif excitation == 'chirp':
        u = chirp(time, 0.2, time[-1], rng.uniform(8.0, 20.0), phi=-90)
    else:
        u = _steps(time, rng)
    return u / np.abs(u).max()


def _steps(time: FloatArray, rng: Generator) -> FloatArray:
    edges = np.cumsum(rng.uniform(0.05, 0.5, 200))
    levels = rng.uniform(-1.0, 1.0, 201)
    u = levels[np.searchsorted(edges, time)]
    if rng.random() < 0.5:
        keep = math.exp(-(time[1] - time[0]) / rng.uniform(0.005, 0.05))
        u = lfilter([1 - keep], [1, -keep], u)
    return u


def shaft_motion(rng: Generator) -> Motion:
    """Draw theta_d(t), starting smoothly at zero: still, one sinusoid, or two [rad]."""
    count = rng.choice(3, p=[0.25, 0.5, 0.25])
    amplitude = np.exp(rng.uniform(np.log(0.02), np.log(0.2), count)) / max(count, 1)
    omega = 2 * np.pi * np.exp(rng.uniform(np.log(0.2), np.log(5.0), count))
    phase = rng.uniform(0, 2 * np.pi, count)

    def motion(t: FloatArray) -> FloatArray:
        angle = np.sin(np.outer(t, omega) + phase) - np.sin(phase)
        return (1 - np.exp(-(t / 0.1) ** 2)) * (angle @ amplitude)

    return motion


def on_steps(u: FloatArray, substeps: int, interpolation: str) -> FloatArray:
    """Spread a sampled command over the integrator's steps: 'hold' or 'linear' between samples."""
    if interpolation == 'hold':
        return np.repeat(u, substeps)
    middle = (np.arange(len(u) * substeps) + 0.5) / substeps
    return np.interp(middle, np.arange(len(u)), u)


@njit(cache=True)
def play(u: FloatArray, half_width: float) -> FloatArray:
    """Pass a signal through backlash, started in its middle."""
    out = np.empty_like(u)
    last = 0.0
    for i, value in enumerate(u):
        last = min(max(last, value - half_width), value + half_width)
        out[i] = last
    return out


def relay(u: FloatArray, half_width: float, height: float) -> FloatArray:
    """Add a relay with hysteresis: +-height, switched as u passes +-half_width."""
    side = np.zeros_like(u)
    side[u > half_width] = 1.0
    side[u < -half_width] = -1.0
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(u)), 0))
    return u + height * side[last]


@njit(cache=True)
def slew(u: FloatArray, largest: float) -> FloatArray:
    """Let u change by at most this much a step."""
    out = np.empty_like(u)
    last = 0.0
    for i, value in enumerate(u):
        last = min(max(value, last - largest), last + largest)
        out[i] = last
    return out


def delayed(u: FloatArray, delay: float, step: float, kind: str) -> FloatArray:
    """Delay u [s]: 'pure' (to the step), 'pade' (first order, all-pass) or 'lags' (three)."""
    if kind == 'pure':
        n = round(delay / step)
        return np.concatenate((np.zeros(n), u[:len(u) - n]))
    if kind == 'pade':
        num, den = [-delay / 2, 1.0], [delay / 2, 1.0]
    else:
        num, den = [1.0], np.poly([-3.0 / delay] * 3) * (delay / 3.0) ** 3
    b, a = bilinear(num, den, 1.0 / step)
    return lfilter(b, a, u)


def noise(n: int, rng: Generator, memory: float) -> FloatArray:
    """Draw noise of unit variance, an AR(1) process with this memory from sample to sample."""
    white = rng.standard_normal(n + 200)
    return lfilter([math.sqrt(1 - memory**2)], [1, -memory], white)[200:]
