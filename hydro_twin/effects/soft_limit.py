"""A limit that is approached gradually: the law, and what tells it from a bend."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import EffectParameter

HARD = 0.02             # softness below which there is a corner
REACHED = 0.8           # share of a limit that a soft one must come to, or it is but a bend
SOFTEST = 0.45          # softness of no limit any more: a tanh has 0.37, orifice flow 0.5 or more
TANH = 0.37             # softness from which a search begins

SOFTNESS = EffectParameter('softness', 'of the corners, one over their power', '1', 0.0, SOFTEST,
                           log=False, refinement=0.0)


@compiled
def limited(v, limit, softness):  # type: ignore[no-untyped-def]
    """Keep the magnitude of v below a limit, v / (1 + |v / limit|^n)^(1/n), n = 1 / softness.

    With a softness of 0.37 that is limit tanh(v / limit) to 2 %.
    """
    if softness < HARD:
        return min(max(v, -limit), limit)
    return v / (1.0 + (abs(v) / limit)**(1.0 / softness))**softness


def is_limit(low: float, high: float, lower: float, upper: float, softness: float) -> bool:
    """Whether what passes, from low to high, comes to either limit, and finds a corner there."""
    reached = high >= REACHED * upper or low <= REACHED * lower
    return reached and softness < 0.99 * SOFTEST
