"""Orifice flow where the load is not measured: a speed whose viscous load takes up the supply."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give the speed y of y = v sqrt(1 - |y| / v_l), solved for y.

    This is flow through the valve, v sqrt(1 - sign(x_v) p_L / p_s) [Merritt 1967, eq. 5-25], with
    the load pressure of a viscous load, p_L / p_s = y / v_l. With unequal areas, or a load that
    stays, v_l (1 + imbalance) up and v_l (1 - imbalance) down.
    """
    half = 0.5 * abs(v) / (p[0] * (1.0 + p[1] if v > 0.0 else 1.0 - p[1]))
    return v / (math.sqrt(1.0 + half * half) + half)


def starts(span: Span) -> Starts:
    """Speeds of full load as multiples of the largest speed."""
    return [(factor * span.value, 0.0) for factor in (0.7, 1.5, 4.0)]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Let the two ways differ."""
    return [(values[0], 0.2), (values[0], -0.2)]


EFFECT = Effect(
    id='orifice',
    title='orifice flow',
    kinds=('speed',),
    reads=('opening',),                     # not by the law: it sits only where there is one
    parameters=(
        EffectParameter('full_load_speed', 'speed v_l at which the load takes up all of the '
                        'supply pressure', 'value', 1e-9, 1e9, scales=-1),
        EffectParameter('imbalance', 'half the difference of that up and down over their mean',
                        '1', -0.9, 0.9, log=False, refinement=0.0),
    ),
    starts=starts,
    excitation='use slow and fast movements, up to the largest speed',
    refined=refined,
    law=law,
)
