"""Orifice flow: the flow through a valve falls as the load takes up the supply pressure."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give K_q x_v sqrt(1 - sign(x_v) p_L / p_s) [Merritt 1967, eq. 5-25]."""
    opening, load_pressure, p_s = s[0], s[1], p[0]
    drop = 1.0 - load_pressure / p_s if opening > 0.0 else 1.0 + load_pressure / p_s
    return v * math.sqrt(drop) if drop > 0.0 else 0.0


def starts(span: Span) -> Starts:
    """Supply pressures as multiples of the largest load pressure."""
    return [(factor * span.signals['load_pressure'],) for factor in (1.1, 1.5, 2.5, 5.0, 12.0)]


EFFECT = Effect(
    id='orifice',
    title='orifice flow',
    kinds=('flow',),
    reads=('opening', 'load_pressure'),
    parameters=(
        EffectParameter('supply_pressure', 'supply pressure p_s', 'load_pressure', 1e3, 1e11,
                        scales=-1),
    ),
    starts=starts,
    excitation='ask for flow at high load pressure',
    law=law,
)
