"""What an unknown input at a port may depend on: families of laws with coefficients."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_twin.plants import Port
from hydro_twin.plants.plant import FloatArray

KNOTS = 16          # intervals of a curve: with 8, the gap of a play falls between two knots
# Half widths of loops, in shares of half the range: from hardly a loop to the half of it.
LOOPS = (0.03, 0.06, 0.12, 0.25, 0.5)


def signatures(port: Port, value: FloatArray, signals: FloatArray) -> Mapping[str, FloatArray]:
    """List the families of laws at a port.

    Args:
        port: the port.
        value: what reaches it, (N,).
        signals: what an effect may read there beside, (N, as many as the port declares).

    Returns:
        By what the law depends on, the signatures whose sum, each times a coefficient, it is,
        (how many, N): curves over the value, its rate of change and the signals, and loops.
    """
    read = {'value': value, 'rate': np.diff(value, prepend=value[0]),
            **dict(zip(port.signals, signals.T, strict=True))}
    return {**{name: curve(signal) for name, signal in read.items()}, 'loop': loops(value)}


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
        held = np.clip(held + step, -half, half)
        out[k] = held
    return out.T / np.maximum(half, np.finfo(float).tiny)[:, None]
