"""End stop: a piston or an actuator that stands at the end of its stroke."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts

NO_STOP = 1e9           # a stop that is not there


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Correct the speed so that the position stays between lower and upper.

    Solved for the end of the step: the stop removes only the speed that would lead beyond it, so
    that the axis leaves the stop as soon as the drive reverses (complementarity, Moreau's time
    stepping). A saturation behind an integrator would wind up.
    """
    if h == 0.0:
        return v
    return v + (min(max(s[0], p[0]), p[1]) - s[0]) / c


def starts(span: Span) -> Starts:
    """Both ends of what was measured, or either; and somewhat inside."""
    low, high = span.measured
    inside = 0.03 * (high - low)
    return [(lower, upper) for margin in (0.0, inside) for lower, upper in (
        (low + margin, high - margin), (-NO_STOP, high - margin), (low + margin, NO_STOP))]


EFFECT = Effect(
    id='end_stop',
    title='end stop',
    kinds=('speed',),
    reads=('position',),
    parameters=(
        EffectParameter('lower', 'lower end of the stroke', 'position', -NO_STOP, NO_STOP,
                        log=False, unreached=-NO_STOP),
        EffectParameter('upper', 'upper end of the stroke', 'position', -NO_STOP, NO_STOP,
                        log=False, unreached=NO_STOP),
    ),
    starts=starts,
    excitation='drive it against the end of its stroke, and back',
    beyond_reach=True,
    law=law,
    implicit=True,
)
