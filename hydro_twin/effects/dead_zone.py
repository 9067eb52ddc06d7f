"""Dead zone: a valve with overlap, an amplifier that ignores small commands, rod and hinge."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts

HALF = 0.5              # share that passes, from which a zone is a bend of the gain, not dead


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Pass what exceeds +-width about the centre, and a share of the rest [Merritt 1967, 5.3].

    The share is that of a spool whose overlap does not seal. Behind an actuator the width is
    how far it moves before the valve does, l_1 and l_2 of [L18] figure 1.
    """
    width, centre, leak = p[0], p[1], p[2]
    w = v - centre
    return w - (1.0 - leak) * min(max(w, -width), width)


def starts(span: Span) -> Starts:
    """Widths as shares of the largest value.

    A little off the middle, so that a search finds edges that differ; alike ones are tried
    afterwards.
    """
    return [(share * span.value, 0.05 * share * span.value, 0.0)
            for share in (0.01, 0.03, 0.08, 0.2, 0.4)]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Move the zone off the middle; let it leak."""
    width, centre, _ = values
    return [(width, 0.2 * width, 0.0), (width, -0.2 * width, 0.0), (1.3 * width, centre, 0.2)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Separate a zone about rest that lets little pass, and is entered, from a bias or a kink."""
    width, centre, leak = values
    return abs(centre) < width and leak < HALF and any(
        low <= leak * width and high >= -leak * width for low, high in span.ranges)


EFFECT = Effect(
    id='dead_zone',
    title='dead zone',
    kinds=('opening', 'command', 'pilot', 'linkage', 'stem'),
    parameters=(
        EffectParameter('width', 'half width of the zone', 'value', 1e-12, 1e9),
        EffectParameter('centre', 'middle of the zone', 'value', -1e9, 1e9, log=False,
                        refinement=0.0),
        EffectParameter('leak', 'share that passes within the zone', '1', 0.0, 0.9, log=False,
                        refinement=0.0),
    ),
    starts=starts,
    excitation='use small slow commands about the middle',
    refined=refined,
    distinguishable=distinguishable,
    law=law,
)
