"""Stiffening: a coupling that gets stiffer as it twists."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give G twist (1 + k twist^2), the cubic spring of Duffing."""
    return v * (1.0 + p[0] * s[0] * s[0])


def starts(span: Span) -> Starts:
    """Raise the stiffness by a tenth, a half and twice at the largest twist."""
    return [(rise / max(span.signals['twist'], 1e-12) ** 2,) for rise in (0.1, 0.5, 2.0)]


EFFECT = Effect(
    id='stiffening',
    title='stiffening coupling',
    kinds=('coupling',),
    reads=('twist',),
    parameters=(
        EffectParameter('cubic', 'rise k of the stiffness with the twist squared', '1/twist^2',
                        1e-9, 1e15),
    ),
    starts=starts,
    excitation='twist the coupling far, both ways',
    law=law,
)
