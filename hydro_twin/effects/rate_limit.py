"""Rate limit: a spool, a cylinder or an actuator that cannot move faster."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts
from hydro_twin.effects.soft_limit import is_limit, limited, SOFTNESS, TANH

LASTING = 3             # samples: a limit that is over sooner is a lag that no sample resolves


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Keep the speed v between -limit (1 - imbalance) and limit (1 + imbalance).

    A soft limit is approached as in `limited`.
    """
    return limited(v, p[0] * (1.0 + p[1] if v > 0.0 else 1.0 - p[1]), p[2])


def starts(span: Span) -> Starts:
    """Limits at shares of the largest speed.

    A little uneven, so that a search finds limits that differ; alike ones are tried afterwards.
    """
    return [(share * span.value, 0.05, 0.0) for share in (0.95, 0.8, 0.6, 0.4, 0.25, 0.12)]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Let one way go free, where the other keeps the limit, or half of it; or soften both."""
    ways = []
    for limit in (values[0], 0.5 * values[0]):
        mean = 0.5 * (limit + max(span.value, 2.0 * limit))
        ways += [(mean, 1.0 - limit / mean, 0.0), (mean, limit / mean - 1.0, 0.0)]
    return [*ways, (values[0], values[1], TANH)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Distinguish a limit from a gain that falls, if it is reached, and a lag, if it lasts."""
    limit, imbalance, softness = values
    return span.lasting >= LASTING and is_limit(
        span.low, span.high, -limit * (1.0 - imbalance), limit * (1.0 + imbalance), softness)


EFFECT = Effect(
    id='rate_limit',
    title='rate limit',
    kinds=('rate', 'speed'),
    parameters=(
        EffectParameter('limit', 'largest speed', 'value', 1e-12, 1e12),
        EffectParameter('imbalance', 'half the difference of the limits up and down over their '
                        'mean', '1', -0.999, 0.999, log=False, refinement=0.0),
        SOFTNESS,
    ),
    starts=starts,
    excitation='use fast large steps',
    beyond_reach=True,
    refined=refined,
    distinguishable=distinguishable,
    law=law,
    simpler='saturation',
)
