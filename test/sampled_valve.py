"""A valve with overlap on a cylinder, whose command changes at any time between two samples."""
from __future__ import annotations

import numpy as np

from hydro_twin.fitting.parts import Part

LAG, GAIN = 0.04, 0.03          # s; m/s per unit of the command
LOWER, UPPER = -1.4, 0.5        # edges of the overlap
SAMPLE_TIME, NOISE = 0.05, 1e-5


def recorded(seed, seconds=60):
    """Move the rod about its middle, by steps of Euler at 1 kHz; record every fiftieth."""
    rng = np.random.default_rng(seed)
    n = 1000 * seconds
    changes = np.cumsum(rng.uniform(150, 900, n // 150))
    levels = rng.uniform(-4.0, 4.0, len(changes) + 1)
    command, x = np.empty(n), np.empty(n)
    speed, position = 0.0, 0.3
    for k in range(n):
        command[k] = levels[np.searchsorted(changes, k)] - 10.0 * (position - 0.3)
        passed = command[k] - np.clip(command[k], LOWER, UPPER)
        speed += 0.001 / LAG * (GAIN * passed - speed)
        position += 0.001 * speed
        x[k] = position
    return Part(command[::50, None].copy(), x[::50] + NOISE * rng.standard_normal(len(x[::50])))
