"""A free curve: what is found to be missing at a port, without a law that would explain it.

It takes no part in the search for a name, and is no effect of the catalogue.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Placed
from hydro_twin.plants.plant import Port

KNOTS = 9
ANY = 1e15              # beyond any value of any port or signal


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Add a curve over a signal: cubic between evenly spaced knots, straight on beyond them.

    The slope at a knot is that of the line through its neighbours [Catmull and Rom 1974].
    """
    low, high, last = p[0], p[1], len(p) - 3
    place = (s[0] - low) / (high - low) * last
    if place < 0.0:
        return v + p[2] + place * (p[3] - p[2])
    if place > last:
        return v + p[last + 2] + (place - last) * (p[last + 2] - p[last + 1])
    k = min(int(place), last - 1)
    t, at = place - k, k + 2
    rise = p[at + 1] - p[at]
    left = 0.5 * (p[at + 1] - p[at - 1]) if k > 0 else rise
    right = 0.5 * (p[at + 2] - p[at]) if k < last - 1 else rise
    return v + p[at] + t * (left + t * (3.0 * rise - 2.0 * left - right
                                        + t * (left + right - 2.0 * rise)))


CURVE = Effect(
    id='curve',
    title='free curve',
    kinds=(),
    parameters=(
        EffectParameter('low', 'first knot', 'signal', -ANY, ANY, log=False, fixed=True),
        EffectParameter('high', 'last knot', 'signal', -ANY, ANY, log=False, fixed=True),
        *(EffectParameter(f'added_{k + 1}', f'what is added at knot {k + 1}', 'value',
                          -ANY, ANY, log=False) for k in range(KNOTS)),
    ),
    starts=lambda _: (),
    excitation='',
    law=law,
    explains=False,
)


def curve(port: Port, signal: str, low: float, high: float, added: FloatArray,
          limit: float = ANY) -> Placed:
    """Put a curve on a port.

    Args:
        port: where it adds.
        signal: over which: 'value', what reaches the port, or a signal there.
        low: first knot.
        high: last knot, above the first.
        added: at the knots, shape (KNOTS,).
        limit: largest magnitude of these that a fit may come to.
    """
    return Placed(of_kind(port.kind, signal, limit), port,
                  (float(low), float(high), *map(float, added)))


def values(placed: Placed, signal: FloatArray) -> FloatArray:
    """Evaluate what a curve adds where its signal has these values, shape (N,)."""
    p, nothing = np.array(placed.values), np.zeros(0)
    return np.array([law(0.0, np.array([s]), p, nothing, 0.0, 0.0, nothing) for s in signal])


def of_kind(kind: str, signal: str, limit: float = ANY) -> Effect:
    """Give the effect that reads this signal at ports of this kind, its values within a limit."""
    low, high, *added = CURVE.parameters
    return replace(CURVE, kinds=(kind,), reads=(signal,), parameters=(
        replace(low, unit=signal), replace(high, unit=signal),
        *(replace(parameter, lower=-limit, upper=limit) for parameter in added)))
