"""Gain that changes with the opening."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give v (1 + slope position), the gain never below zero."""
    return v * max(1.0 + p[0] * s[0], 0.0)


def starts(span: Span) -> Starts:
    """Gain up and down by a fifth and by half over the range."""
    reach = max(span.signals['position'], 1e-12)
    return [(change / reach,) for change in (0.2, -0.2, 0.5, -0.5)]


EFFECT = Effect(
    id='gain',
    title='gain that changes with the opening',
    kinds=('speed',),
    reads=('position',),
    parameters=(
        EffectParameter('slope', 'relative change of the gain over the opening', '1/position',
                        -1e6, 1e6, log=False, scales=1),
    ),
    starts=starts,
    excitation='use small movements about several openings',
    law=law,
)
