"""Mode of a measurement: a resonance of the transducer, or a filter of second order."""
from __future__ import annotations

from dataclasses import replace
import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.mode import EFFECT as OF_COMMANDS
from hydro_twin.effects.mode import TURN


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give y of y'' + 2 damping w y' + w^2 y = w^2 v, w = 2 pi natural_frequency, from rest.

    Exact where v is linear over a step. z is y - v, y' / w, v, and 1 from the first step on.
    """
    if z[3] == 0.0:
        z_next[0] = 0.0
        z_next[1] = 0.0
        z_next[2] = v
        z_next[3] = 1.0 if h > 0.0 else 0.0
        return v
    if h == 0.0:
        return v + z[0]
    damping = p[1]
    a = TURN * p[0] * h
    root = math.sqrt(max(1.0 - damping * damping, 1e-12))
    decay = math.exp(-damping * a)
    cosine = decay * math.cos(root * a)
    sine = decay * math.sin(root * a) / root
    rise = (v - z[2]) / a
    off = z[0] + 2.0 * damping * rise       # from the ramp that follows v
    speed = z[1] - rise
    z_next[0] = (cosine + damping * sine) * off + sine * speed - 2.0 * damping * rise
    z_next[1] = (cosine - damping * sine) * speed - sine * off + rise
    z_next[2] = v
    return v + z_next[0]


EFFECT = replace(OF_COMMANDS, kinds=('sensor',), law=law, memory=4, shows=())
