"""Backlash: play in a coupling, a gear or a linkage."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Quantity, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Transmit torque only for the twist beyond the gap, G (twist -+ gap).

    See [Nordin and Gutman 2002, 2.1]. The value v is proportional to the twist, so it is scaled by
    the share of the twist beyond the gap.
    """
    gap, twist = p[0], s[0]
    if abs(twist) <= gap:
        return 0.0
    return v * (1.0 - gap / abs(twist))


def starts(span: Span) -> Starts:
    """Gaps as shares of the largest twist."""
    return [(share * span.signals['twist'],) for share in (0.01, 0.03, 0.1, 0.3, 1.0)]


EFFECT = Effect(
    id='backlash',
    title='backlash',
    countable=False,
    kinds=('coupling',),
    reads=('twist',),
    parameters=(EffectParameter('gap', 'half of the play', 'twist', 1e-12, 1e3),),
    starts=starts,
    excitation='let the load change sign slowly, so that the play is crossed',
    law=law,
    # -1 and 1 are the sides of the gap; beyond them it is closed, and the torque passes.
    shows=(Quantity('side', '1', lambda p: {'twist': 1.0 / p[0]}),),
)
