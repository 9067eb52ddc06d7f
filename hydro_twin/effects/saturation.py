"""Saturation: a stroke or an amplifier that ends."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts
from hydro_twin.effects.soft_limit import HARD, is_limit, limited, SOFTNESS, TANH


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Keep the value between lower and upper; d_1 of [L18] is upper at the stem.

    Soft limits on both sides of zero are approached as in `limited`.
    """
    lower, upper, softness = p[0], p[1], p[2]
    if softness < HARD or lower >= 0.0 or upper <= 0.0:
        return min(max(v, lower), upper)
    return limited(v, upper if v > 0.0 else -lower, softness)


def starts(span: Span) -> Starts:
    """Both ends, or either, at shares of the largest value; the other end out of reach."""
    far = 10.0 * span.value
    return [(*limits, 0.0) for share in (0.98, 0.9, 0.75, 0.5, 0.3) for limits in (
        (-share * span.value, share * span.value),
        (-far, share * span.value),
        (-share * span.value, far))]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Soften limits about zero."""
    lower, upper, _ = values
    return [(lower, upper, TANH)] if lower < 0.0 < upper else []


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Distinguish a soft limit that is reached, at least one way, from a gain that falls."""
    lower, upper, softness = values
    return softness < HARD or is_limit(span.low, span.high, lower, upper, softness)


EFFECT = Effect(
    id='saturation',
    title='saturation',
    kinds=('opening', 'command', 'stem', 'linkage'),
    parameters=(
        EffectParameter('lower', 'least value', 'value', -1e9, 1e9, log=False,
                        unreached=-1e9),
        EffectParameter('upper', 'largest value', 'value', -1e9, 1e9, log=False,
                        unreached=1e9),
        SOFTNESS,
    ),
    starts=starts,
    excitation='use large commands, to the end of the stroke',
    beyond_reach=True,
    refined=refined,
    distinguishable=distinguishable,
    law=law,
)
