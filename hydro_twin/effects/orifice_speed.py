"""Orifice flow where the load is not measured: a speed whose load takes up the supply pressure."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Quantity, Span, Starts

GAMMA = 2.0 - math.sqrt(2.0)    # share of a step that TR-BDF2 takes by the trapezoidal rule
ROUND = 1e-9            # of the pressure drop: keeps the slope of its root finite
STILL = 1e-3            # of the travel that was due: what moved less stands at an end stop
TINY = 1e-300           # keeps a quotient of nothing by nothing finite
COMPRESSED = 0.3        # travel that compresses the oil, of that made while the mass accelerates


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give the speed y of a load behind a valve that moves it at v where nothing resists.

    P is the load pressure over that of the supply, at most 1 + imbalance up, 1 - imbalance down:
        inertia y' = P - y / v_l                                    [Newton]
        compliance P' = v sqrt(1 - P / P_most) - y      [Merritt 1967, eq. 5-25, and continuity]
    Without inertia, y = v sqrt(1 - |y| / (v_l |P_most|)), solved for y. A step is one of TR-BDF2
    [Bank et al. 1985]: of second order, it neither damps what swings nor rings where oil is stiff.

    At an end stop y is zero. z is v, y and P at the start of the step; the position at the start
    of the last step, the travel that was due in that, and the same if none was made (what is
    written at h = 0, the start of a step, stays); and whether there was a step.
    """
    inertia, compliance = p[2], p[3]
    if inertia == 0.0 or z[6] == 0.0:
        half = 0.5 * abs(v) / (p[0] * abs(most(v, p[1])))
        steady = v / (math.sqrt(1.0 + half * half) + half)
        z_next[0] = v
        z_next[1] = steady
        z_next[2] = steady / p[0]
        z_next[3] = s[1]
        z_next[6] = 1.0
        return steady
    if h == 0.0:
        stands = abs(s[1] - z[3]) < STILL * abs(z[4])
        z_next[3] = s[1]
        z_next[5] = z[4] if stands else 0.0
        return 0.0 if stands else z[1]
    # What stood in the last step still does, unless it has begun to go back since.
    y0 = 0.0 if z[5] * z[1] > 0.0 else z[1]
    P0 = z[2]
    g = 0.5 * GAMMA * h
    a = g / inertia
    b = 1.0 / (1.0 + a / p[0])
    y = y0 + a * (P0 - y0 / p[0])
    known = compliance * P0 + g * (flow(z[0], P0, p[1]) - y0 - b * y)
    P = pressure(z[0] + GAMMA * (v - z[0]), known, compliance + g * a * b, g, p[1])
    y = b * (y + a * P)
    new = 1.0 / (GAMMA * (2.0 - GAMMA))
    old = new - 1.0
    y = new * y - old * y0
    known = compliance * (new * P - old * P0) - g * b * y
    P = pressure(v, known, compliance + g * a * b, g, p[1])
    y = b * (y + a * P)
    z_next[0] = v
    z_next[1] = y
    z_next[2] = P
    z_next[4] = 0.5 * h * (y0 + y)
    return y


@compiled
def most(v, imbalance):  # type: ignore[no-untyped-def]
    """Give P_most, with its sign."""
    return 1.0 + imbalance if v > 0.0 else imbalance - 1.0


@compiled
def flow(v, P, imbalance):  # type: ignore[no-untyped-def]
    """Give v sqrt(1 - P / P_most): back through the valve where P is above what is supplied."""
    drop = 1.0 - P / most(v, imbalance)
    return v * drop / math.sqrt(abs(drop) + ROUND)


@compiled
def pressure(v, known, factor, g, imbalance):  # type: ignore[no-untyped-def]
    """Solve factor P = known + g v sqrt(1 - P / P_most), quadratic in the root, for P."""
    limit = most(v, imbalance)
    linear = g * abs(v)
    square = factor * abs(limit)
    lacking = square - known if v > 0.0 else square + known
    root = 2.0 * lacking / (
        linear + math.sqrt(linear * linear + 4.0 * square * abs(lacking)) + TINY)
    return limit * (1.0 - root * abs(root))


def starts(span: Span) -> Starts:
    """Speeds of full load as multiples of the largest speed."""
    return [(factor * span.value, 0.0, 0.0, 0.0) for factor in (0.7, 1.5, 4.0)]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Give the load a mass, on compressible oil and on stiff oil; or let the two ways differ.

    What accelerates a mass was taken for a viscous load, of which there is less. A mass that was
    found may be on compressible oil, too: else a mode of the command takes its place.
    """
    full, imbalance, inertia, _ = values
    loaded = [(4.0 * full, uneven, time / span.value, compressed * time * span.value)
              for time in (2.0 * span.sample_time, 16.0 * span.sample_time)
              for uneven, compressed in ((0.1, COMPRESSED), (0.0, COMPRESSED), (0.0, 0.0))]
    if inertia > 0.0:
        loaded.append((full, imbalance, inertia, COMPRESSED * inertia * span.value**2))
    return [*loaded, (full, 0.2, 0.0, 0.0), (full, -0.2, 0.0, 0.0)]


EFFECT = Effect(
    id='orifice',
    title='orifice flow',
    kinds=('speed',),
    reads=('opening', 'position'),  # the former not by the law: it sits only where there is one
    parameters=(
        EffectParameter('full_load_speed', 'speed v_l at which the load takes up all of the '
                        'supply pressure', 'value', 1e-9, 1e9, scales=-1),
        EffectParameter('imbalance', 'half the difference of the largest load pressure up and '
                        'down over their mean', '1', -0.9, 0.9, log=False, refinement=0.0),
        EffectParameter('inertia', 'mass over the force of the supply pressure', 's^2/position',
                        0.0, 1e9, log=False, refinement=0.0),
        EffectParameter('compliance', 'travel by which the supply pressure compresses the oil',
                        'position', 0.0, 1e9, log=False, refinement=0.0),
    ),
    starts=starts,
    excitation='use slow and fast movements, up to the largest speed',
    refined=refined,
    law=law,
    memory=7,
    keeps_by='inertia',
    shows=(Quantity('load_pressure', '1', lambda _: {2: 1.0}),),
)
