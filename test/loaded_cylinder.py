"""A cylinder that moves a mass with compressible oil, in small steps: a truth for tests."""
import math

import numpy as np

FINE = 200              # steps in a sample


def moved(command, sample_time, tau, K_v, load, stroke=(-math.inf, math.inf)):
    """Return position and load pressure, over that of the supply, at each sample of a command.

    load: the parameters of `orifice` at the piston; stroke: where the piston stands.
    """
    fine = sample_time / FINE
    q = x = y = P = 0.0
    at = np.empty((2, len(command)))
    for k, held in enumerate(command):
        at[:, k] = x, P
        for _ in range(FINE):
            q += fine * (held - q) / tau
            drop = 1.0 - P * math.copysign(1.0, q)
            flow = K_v * q * math.copysign(math.sqrt(abs(drop)), drop)
            P += fine * (flow - y) / load['compliance']
            y += fine * (P - y / load['full_load_speed']) / load['inertia']
            x += fine * y
            if not stroke[0] < x < stroke[1]:
                x, y = min(max(x, stroke[0]), stroke[1]), 0.0
    return at
