"""Asymmetry: more flow, or speed, in one direction than in the other."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give v (1 + imbalance sign v): the slopes either way are (1 +- imbalance) times the mean."""
    return v + p[0] * abs(v)


def starts(span: Span) -> Starts:
    """Either way."""
    return [(0.1,), (-0.1,), (0.4,), (-0.4,)]


EFFECT = Effect(
    id='asymmetry',
    title='asymmetry',
    kinds=('flow', 'speed'),
    parameters=(
        EffectParameter('imbalance', 'half the difference of the slopes over their mean', '1',
                        -0.95, 0.95, log=False, scales=1),
    ),
    starts=starts,
    excitation='move it slowly both ways about the middle, by the same amount',
    law=law,
)
