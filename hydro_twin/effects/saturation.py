"""Saturation: a stroke or an amplifier that ends."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Keep the value between lower and upper; d_1 of [L18] is upper at the stem."""
    return min(max(v, p[0]), p[1])


def starts(span: Span) -> Starts:
    """Both ends, or either, at shares of the largest value; the other end out of reach."""
    far = 10.0 * span.value
    return [limits for share in (0.98, 0.9, 0.75, 0.5, 0.3) for limits in (
        (-share * span.value, share * span.value),
        (-far, share * span.value),
        (-share * span.value, far))]


EFFECT = Effect(
    id='saturation',
    title='saturation',
    kinds=('opening', 'command', 'stem', 'linkage'),
    parameters=(
        EffectParameter('lower', 'least value', 'value', -1e9, 1e9, log=False,
                        unreached=-1e9),
        EffectParameter('upper', 'largest value', 'value', -1e9, 1e9, log=False,
                        unreached=1e9),
    ),
    starts=starts,
    excitation='use large commands, to the end of the stroke',
    beyond_reach=True,
    law=law,
)
