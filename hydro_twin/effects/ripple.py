"""Ripple: torque that is periodic in the angle of the motor, as each piston gives it."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """v + cosine cos(n position) + sine sin(n position), n periods a turn (2 pi)."""
    angle = p[2] * s[0]
    return v + p[0] * math.cos(angle) + p[1] * math.sin(angle)


def starts(span: Span) -> Starts:
    """Every number of periods that the movement tells from its neighbours, in both phases."""
    reach = max(span.signals['position'], 1e-9)
    step = min(max(0.5 / reach, 0.5), 6.0)
    orders = [3.0 + step * k for k in range(int(60.0 / step))]
    small = 0.03 * span.value
    return [phase for n in orders for phase in ((small, 0.0, n), (0.0, small, n))]


EFFECT = Effect(
    id='ripple',
    title='torque ripple',
    kinds=('force',),
    reads=('position',),
    parameters=(
        EffectParameter('cosine', 'amplitude in cosine phase', 'value', -1e9, 1e9, log=False),
        EffectParameter('sine', 'amplitude in sine phase', 'value', -1e9, 1e9, log=False),
        EffectParameter('periods', 'periods a turn', '1', 1.0, 1e3, log=False),
    ),
    starts=starts,
    law=law,
)
