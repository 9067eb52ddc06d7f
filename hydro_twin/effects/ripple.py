"""Ripple: torque that is periodic in the angle of the motor, as each piston gives it."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give v + cosine cos(n position) + sine sin(n position), n periods a turn (2 pi)."""
    angle = p[2] * s[0]
    return v + p[0] * math.cos(angle) + p[1] * math.sin(angle)


def starts(span: Span) -> Starts:
    """Every number of periods that the movement tells from its neighbours, in both phases."""
    travel = max(span.travel['position'], 1e-9)
    step = min(max(1.0 / travel, 0.5), 6.0)
    small = 0.03 * span.value
    return [values for k in range(int(60.0 / step))
            for values in ((small, 0.0, 3.0 + step * k), (0.0, small, 3.0 + step * k))
            if told(span, values)]


def told(span: Span, values: tuple[float, ...]) -> bool:
    """Less than half a period is a bias, or a spring, for all one can see."""
    return values[2] * span.travel['position'] > math.pi


EFFECT = Effect(
    id='ripple',
    title='torque ripple',
    kinds=('force',),
    reads=('position',),
    unit_read='rad',
    parameters=(
        EffectParameter('cosine', 'amplitude in cosine phase', 'value', -1e9, 1e9, log=False),
        EffectParameter('sine', 'amplitude in sine phase', 'value', -1e9, 1e9, log=False),
        EffectParameter('periods', 'periods a turn', '1', 1.0, 1e3, log=False),
    ),
    starts=starts,
    excitation='turn the motor slowly through several periods',
    told=told,
    law=law,
)
