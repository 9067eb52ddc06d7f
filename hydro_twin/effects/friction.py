"""Dry friction on a moving mass."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import ADDED, Effect, EffectParameter, Quantity, Span, Starts

BREAKAWAY = 2.0         # extra force to break away over that of sliding: dry metals have up to 1


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Take elastic-plastic friction off a force: bristles that bend, then slide.

    The bristles bend by z with dz/dt = velocity while sigma z stays below the sliding force
        g(velocity) = F_c + F_s exp(-(velocity / v_s)^2),
    and slide at it [Canudas de Wit et al. 1995, eqs 1 to 4, in the elastic-plastic limit of
    Dupont et al. 2002]. Solved for the end of the step, so that a stiff bristle holds the mass
    rather than making it chatter (Moreau's time stepping); sigma = inf is Coulomb's law, for which
    the moment at which a mass comes to rest is found, too.
    With w > 0 the mass creeps instead of sticking: g tanh(velocity / w), and no bristles.
    """
    F_c, F_s, v_s, sigma, w = p[0], p[1], p[2], p[3], p[4]
    if h == 0.0:
        return v
    free, was = s[0], z[1]
    if w == 0.0 and math.isinf(sigma):
        side = math.copysign(1.0, was if was != 0.0 else free)
        force = side * mean_force(F_c, F_s, v_s, c, abs(was), side * free)
        z_next[1] = free - c * force
        return v - force
    g = sliding(F_c, F_s, v_s, c, max(math.copysign(1.0, free) * was, 0.0), abs(free))
    if w > 0.0:
        z_next[1] = creeping(free, c * g, w)
        return v - (free - z_next[1]) / c
    # The force that would stop bristle and mass together at the end of the step.
    force = min(max(sigma * (z[0] + h * free) / (1.0 + sigma * h * c), -g), g)
    z_next[0] = force / sigma
    z_next[1] = free - c * force
    return v - force


@compiled
def sliding(F_c, F_s, v_s, c, before, free):  # type: ignore[no-untyped-def]
    """Give g at the mean speed over a step from `before` to free - c g: of second order."""
    g = F_c + F_s * math.exp(-(before / v_s) ** 2)
    for _ in range(2):
        after = max(free - c * g, 0.0)
        g = F_c + F_s * math.exp(-(0.5 * (before + after) / v_s) ** 2)
    return g


@compiled
def mean_force(F_c, F_s, v_s, c, before, free):  # type: ignore[no-untyped-def]
    """Give the force against the motion, as its mean over a step, where nothing is elastic.

    The step begins at a velocity `before`, not below zero, and would end at `free`. A mass that
    comes to rest within it stays there, or slides back for the rest of the step with friction the
    other way. Were it to rest until the end, its velocity would be off at each turn, by up to
    that at the start.
    """
    g = sliding(F_c, F_s, v_s, c, before, free)
    if free - c * g >= 0.0:
        return g
    back = before - free        # gained against the motion in a whole step
    rest = 1.0 - before / (back + c * g)
    return (free + rest * max(back - c * sliding(F_c, F_s, v_s, c, 0.0, back), 0.0)) / c


@compiled
def creeping(free, most, w):  # type: ignore[no-untyped-def]
    """Solve velocity + most tanh(velocity / w) = free, to rounding.

    The left side is concave for positive velocities, so Newton's method climbs from below.
    """
    target = abs(free)
    velocity = target / (1.0 + most / w)
    for _ in range(30):
        share = math.tanh(velocity / w)
        slope = 1.0 + most / w * (1.0 - share * share)
        step = (target - velocity - most * share) / slope
        velocity += step
        if step <= 1e-14 * target:
            break
    return math.copysign(velocity, free)


def starts(span: Span) -> Starts:
    """Sliding force against the largest force seen; breakaway, bristles, creep left out."""
    return [(share * span.value, 0.0, 1.0, math.inf, 0.0)
            for share in (0.003, 0.01, 0.03, 0.1, 0.25, 0.5)]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Bristles, then a force to break away, then both; then creep.

    Bristles only where the port has a position, which says how stiff they may be. Stribeck's
    velocity is hard to find from afar, so both start from slow, medium and fast ones.
    """
    F_c = values[0]
    v_s = 0.05 * span.signals['velocity']
    rigid = [(F_c, 0.3 * F_c, share * v_s, math.inf, 0.0) for share in (0.1, 0.4, 2.0)]
    creep = (F_c, 0.0, 1.0, math.inf, v_s)
    if 'position' not in span.signals:
        return [*rigid, creep]
    fitted = math.isfinite(values[3])
    sigma = values[3] if fitted else F_c / (0.01 * span.signals['position'])
    return [(F_c, 0.0, 1.0, sigma, 0.0), *rigid,
            *((F_c, 0.3 * F_c, share * v_s, sigma, 0.0) for share in (0.4, 2.0, 8.0)), creep]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Reject an extra breakaway force so large that it would act as a blow at each reversal."""
    F_c, F_s, *_ = values
    return F_s <= BREAKAWAY * F_c


EFFECT = Effect(
    id='friction',
    title='dry friction',
    countable=False,
    kinds=('force',),
    reads=('velocity',),
    parameters=(
        EffectParameter('coulomb', 'sliding force F_c', 'value', 1e-9, 1e9, scales=1),
        EffectParameter('stribeck', 'extra force F_s to break away', 'value', 0.0, 1e9,
                        log=False, refinement=0.0, scales=1),
        EffectParameter('stribeck_velocity', 'velocity v_s at which that is gone', 'velocity',
                        1e-9, 1e6, refinement=1.0),
        EffectParameter('bristle_stiffness', 'stiffness sigma of the bristles before sliding',
                        'value/position', 1e-6, math.inf, refinement=math.inf),
        EffectParameter('creep_velocity', 'velocity w below which it creeps, not sticks',
                        'velocity', 0.0, 1e6, log=False, refinement=0.0),
    ),
    starts=starts,
    excitation='let the velocity change sign slowly under load',
    refined=refined,
    distinguishable=distinguishable,
    law=law,
    memory=2,
    implicit=True,
    shows=(Quantity('force', 'value', lambda _: {ADDED: -1.0}),),
)
