"""Stiffening: a coupling that gets stiffer as it twists."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts

SOFTEST = 4.0           # rise in the second stage: what is softer in the first is a play


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give G twist (1 + k twist^2), the cubic spring of Duffing.

    With a second stage: and G r (|twist| - d) beyond the twist d.
    """
    risen = v * (1.0 + p[0] * s[0] * s[0])
    if p[1] > 0.0 and abs(s[0]) > p[2]:
        risen += v * p[1] * (1.0 - p[2] / abs(s[0]))
    return risen


def starts(span: Span) -> Starts:
    """Raise the stiffness by a tenth, a half and twice at the largest twist."""
    return [(rise / span.signals['twist'] ** 2, 0.0, 1.0)
            for rise in (0.1, 0.5, 2.0)]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Replace most of the cubic by a second stage."""
    return [(0.1 * values[0], 0.5, share * span.signals['twist']) for share in (0.3, 0.6)]


EFFECT = Effect(
    id='stiffening',
    title='stiffening coupling',
    countable=False,
    kinds=('coupling',),
    reads=('twist',),
    parameters=(
        EffectParameter('cubic', 'rise k of the stiffness with the twist squared', '1/twist^2',
                        1e-9, 1e15, scales=1),
        EffectParameter('stage', 'rise r of the stiffness in a second stage', '1', 0.0, SOFTEST,
                        log=False, refinement=0.0),
        EffectParameter('stage_twist', 'twist d at which that begins', 'twist', 1e-12, 1e3,
                        refinement=1.0),
    ),
    starts=starts,
    excitation='twist the coupling far, both ways',
    refined=refined,
    law=law,
)
