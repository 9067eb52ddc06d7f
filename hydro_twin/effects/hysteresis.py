"""Hysteresis of a valve: the opening lags behind the command by a width, whatever the speed."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Quantity, Span, Starts

MET = 1.9               # half widths between the least and the largest shift of a loop met on both
#                         sides: 2, but for what it keeps before the first scored sample


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Subtract the output of a stop operator, which stays within +-width [Visintin 1994, III.2].

    z is that output less slope v, which is constant between the edges. At slope 1 this is the play
    operator; below 1, part of each small movement passes at once, as with a Bouc-Wen law.
    """
    width, slope = p[0], p[1]
    bound = min(max(z[0] + slope * v, -width), width)
    z_next[0] = bound - slope * v
    return v - bound


def starts(span: Span) -> Starts:
    """Widths as shares of the largest value."""
    return [(share * span.value, 1.0) for share in (0.005, 0.02, 0.06, 0.15, 0.35)]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Small movements that pass in part."""
    return [(values[0], 0.5)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Distinguish a loop that is crossed from a constant that depends on where a run starts.

    It surely is where the value moves by more than the loop behind it; otherwise, if it is met on
    both sides.
    """
    width, slope = values
    return 2.0 * width < slope * span.swing or MET * width < span.added_swing()


EFFECT = Effect(
    id='hysteresis',
    title='hysteresis',
    kinds=('command', 'opening', 'pilot'),
    parameters=(
        EffectParameter('width', 'half width of the loop', 'value', 1e-12, 1e9),
        EffectParameter('slope', 'share of a small movement that is bound', '1', 0.02, 1.0,
                        refinement=1.0),
    ),
    starts=starts,
    excitation='use slow sinusoids of small amplitude, that turn back often',
    refined=refined,
    distinguishable=distinguishable,
    law=law,
    memory=1,
    # -1 and 1 are the sides of the loop.
    shows=(Quantity('side', '1', lambda p: {0: 1.0 / p[0], 'value': p[1] / p[0]}),),
)
