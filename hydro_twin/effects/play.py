"""Backlash where nothing is elastic: the follower moves only when the play is used up."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts
from hydro_twin.effects.hysteresis import distinguishable as is_loop_crossed


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Stay unless the input pushes: the play operator [Visintin 1994, III.2]."""
    gap = p[0]
    z_next[0] = min(max(z[0], v - gap), v + gap)
    return z_next[0]


def starts(span: Span) -> Starts:
    """Gaps as shares of the largest value."""
    return [(share * span.value,) for share in (0.002, 0.01, 0.03, 0.1)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Distinguish a play that is crossed from a follower that stays where a run starts.

    As a hysteresis of slope 1, which is the same law of a command.
    """
    return is_loop_crossed(span, (values[0], 1.0))


EFFECT = Effect(
    id='backlash',
    title='backlash',
    countable=False,
    kinds=('stem', 'linkage'),
    parameters=(EffectParameter('gap', 'half of the play', 'value', 1e-12, 1e9),),
    starts=starts,
    excitation='move it slowly back and forth, so that the play is crossed',
    distinguishable=distinguishable,
    law=law,
    memory=1,
)
