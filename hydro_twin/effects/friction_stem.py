"""Dry friction of a stem without inertia, as in a valve that a spring closes."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Leave of a force what exceeds friction; less does not move the stem.

    As in [Choudhury et al. 2005], but without mass, and with sliding friction only. Forces are
    divided by the stiffness of the spring.
    """
    return v - min(max(v, -p[0]), p[0])


def starts(span: Span) -> Starts:
    """Friction as shares of the largest force."""
    return [(share * span.value,) for share in (0.01, 0.03, 0.1, 0.25, 0.5)]


EFFECT = Effect(
    id='friction',
    title='dry friction',
    countable=False,
    kinds=('balance',),
    parameters=(EffectParameter('coulomb', 'sliding force F_c', 'value', 1e-9, 1e9),),
    starts=starts,
    excitation='let the stem turn back slowly, after small and after large movements',
    law=law,
)
