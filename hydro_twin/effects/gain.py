"""Gain that changes with the opening."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts

LEAST = 0.2             # of the gain at one end over that at the other: the lever of a boom or an
#                         arm changes by less than threefold over its stroke


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give v (1 + slope position), the gain never below zero."""
    return v * max(1.0 + p[0] * s[0], 0.0)


def starts(span: Span) -> Starts:
    """Gain up and down by a fifth and by half over the range."""
    reach = span.signals['position']
    return [(change / reach,) for change in (0.2, -0.2, 0.5, -0.5)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Distinguish a gain that changes from one that is next to none at one end.

    There nothing would move until something else moves it: that is a gap, a stop or a lag.
    """
    gains = [1.0 + values[0] * edge for edge in span.signal_ranges['position']]
    return min(gains) > LEAST * max(gains)


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
    distinguishable=distinguishable,
    excitation='use small movements about several openings',
    law=law,
)
