"""Lag of a measurement: a filter before the card, or a slow transducer."""
from __future__ import annotations

from dataclasses import replace
import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.lag import EFFECT as OF_COMMANDS


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give y of time_constant y' + y = v, from rest; exact where v is linear over a step.

    z is y - v, v, and 1 from the first step on.
    """
    if z[2] == 0.0:
        z_next[0] = 0.0
        z_next[1] = v
        z_next[2] = 1.0 if h > 0.0 else 0.0
        return v
    if h == 0.0:
        return v + z[0]
    a = h / p[0]
    end = math.exp(-a)
    z_next[0] = z[0] * end - (v - z[1]) * (1.0 - end) / a
    z_next[1] = v
    return v + z_next[0]


EFFECT = replace(OF_COMMANDS, kinds=('sensor',), law=law, memory=3, shows=())
