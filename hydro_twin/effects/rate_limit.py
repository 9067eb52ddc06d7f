"""Rate limit: a spool or a cylinder that cannot move faster."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Keep the speed within +-limit."""
    return min(max(v, -p[0]), p[0])


def starts(span: Span) -> Starts:
    """Limits at shares of the largest speed."""
    return [(share * span.value,) for share in (0.95, 0.8, 0.6, 0.4, 0.25, 0.12)]


EFFECT = Effect(
    id='rate_limit',
    title='rate limit',
    kinds=('rate', 'speed'),
    parameters=(EffectParameter('limit', 'largest speed', 'value', 1e-12, 1e12),),
    starts=starts,
    excitation='use fast large steps',
    beyond_reach=True,
    law=law,
)
