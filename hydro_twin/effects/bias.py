"""Bias: a null offset of a valve, a constant torque, a sensor offset."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Add a constant."""
    return v + p[0]


def starts(span: Span) -> Starts:
    """Either way."""
    return [(0.02 * span.value,), (-0.02 * span.value,)]


EFFECT = Effect(
    id='bias',
    title='bias',
    kinds=('command', 'force', 'sensor'),
    parameters=(
        EffectParameter('offset', 'constant added', 'value', -1e9, 1e9, log=False,
                        scales=1),
    ),
    starts=starts,
    excitation='record a stretch with the command at zero',
    law=law,
)
