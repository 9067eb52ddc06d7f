"""What an unknown input at a port may depend on: families of laws with coefficients."""
from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
import math

import numpy as np
from scipy.signal import lfilter

from hydro_twin.arrays import FloatArray
from hydro_twin.plants import Port

KNOTS = 16          # intervals of a curve: with 8, the gap of a play falls between two knots
# Half widths of loops, in shares of half the range: from hardly a loop to the half of it.
LOOPS = tuple(0.03 * 2.0 ** (0.5 * k) for k in range(9))
# Time constants [samples]: below, a lag is a rate of change; above, the walk follows it.
LAGS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)


def signatures(port: Port, value: FloatArray, signals: FloatArray
               ) -> Mapping[str, Callable[[], FloatArray]]:
    """List the families of laws at a port.

    Args:
        port: the port.
        value: what reaches it, (N,).
        signals: what an effect may read there beside, (N, as many as the port declares).

    Returns:
        By name, a function that returns the basis functions of a law, (how many, N): curves over
        the value, its rate of change and the signals, loops, and lags. The law is their weighted
        sum.
    """
    read = {'value': value, 'rate': np.diff(value, prepend=value[0]),
            **dict(zip(port.signals, signals.T, strict=True))}
    return {**{name: partial(curve, signal) for name, signal in read.items()},
            'loop': partial(loops, value), 'lag': partial(lags, value)}


def curve(signal: FloatArray) -> FloatArray:
    """Rise by one over each interval between knots: sums are curves, straight between them.

    Args:
        signal: (N,).

    Returns:
        (`KNOTS`, N), between 0 and 1.
    """
    knots = np.linspace(signal.min(), signal.max(), KNOTS + 1)
    width = max(float(knots[1] - knots[0]), np.finfo(float).tiny)
    found: FloatArray = np.clip((signal - knots[:-1, None]) / width, 0.0, 1.0)
    return found


def loops(signal: FloatArray) -> FloatArray:
    """Follow a signal within half widths, by stop operators: sums are hystereses [Visintin 1994].

    Args:
        signal: (N,).

    Returns:
        (as many as `LOOPS`, N), between -1 and 1.
    """
    half = np.array(LOOPS) * 0.5 * float(np.ptp(signal))
    held, out = np.zeros(len(half)), np.empty((len(signal), len(half)))
    for k, step in enumerate(np.diff(signal, prepend=signal[0]).tolist()):
        held = np.minimum(np.maximum(held + step, -half), half)
        out[k] = held
    return out.T / np.maximum(half, np.finfo(float).tiny)[:, None]


def lags(signal: FloatArray) -> FloatArray:
    """Return first-order lags of a signal, less the signal: weighted sums are linear dynamics.

    Args:
        signal: (N,).

    Returns:
        (as many as `LAGS`, N), in units of half the range of the signal.
    """
    size = max(0.5 * float(np.ptp(signal)), np.finfo(float).tiny)
    kept = [math.exp(-1.0 / lag) for lag in LAGS]
    behind = [lfilter([1.0 - a], [1.0, -a], signal, zi=[a * signal[0]])[0] for a in kept]
    return (np.array(behind) - signal) / size
