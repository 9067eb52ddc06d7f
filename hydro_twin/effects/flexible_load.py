"""Flexible load: a second inertia that a spring ties to the moving one."""
from __future__ import annotations

import math

import numpy as np

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts
from hydro_twin.effects.mode import TURN

STRENGTH = 0.1          # of the load, to begin with: its force at that frequency over the largest
RESONANT = math.sqrt(0.5)       # damping ratio from which there is no resonance
FELT = 0.01             # least force of a load that swings as fast as the motor moves, over the
#                         largest there: a weaker one would need a swing that no motor excites
OCTAVES = 5.5           # down to 0.9 Hz at 500 Hz, of which some seconds hold a few periods


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Add the force k (e + 2 damping e' / w) of a spring that is stretched by e.

        e'' + 2 damping w e' + w^2 e = -acceleration of what carries the spring,

    w = 2 pi natural_frequency, that of the load alone, whose inertia is k / w^2. Exact where the
    velocity is linear over a step. z is e, e' / w, the velocity, and 1 where that is known:
    in the first step it is taken as constant.
    """
    w = TURN * p[0]
    damping = p[1]
    if h == 0.0:
        return v + p[2] * (z[0] + 2.0 * damping * z[1])
    a = w * h
    root = math.sqrt(max(1.0 - damping * damping, 1e-12))
    decay = math.exp(-damping * a)
    cosine = decay * math.cos(root * a)
    sine = decay * math.sin(root * a) / root
    rise = s[0] - z[2] if z[3] > 0.0 else 0.0
    rest = -rise / (a * w)          # to where the acceleration stretches the spring
    off = z[0] - rest
    z_next[0] = rest + (cosine + damping * sine) * off + sine * z[1]
    z_next[1] = (cosine - damping * sine) * z[1] - sine * off
    z_next[2] = s[0]
    z_next[3] = 1.0
    return v + p[2] * (z_next[0] + 2.0 * damping * z_next[1])


def starts(span: Span) -> Starts:
    """Natural frequencies down from a twelfth of the sampling rate by half octaves.

    A resonance is narrow: from an octave away a search may end beside it.
    """
    found = []
    for frequency in 2.0 ** -np.arange(0.0, OCTAVES, 0.5) / (12.0 * span.sample_time):
        stiffness = STRENGTH * span.value * TURN * frequency / span.signals['velocity']
        found.append((float(frequency), 0.1, float(stiffness), 0.0))
    return found


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Let it swing when a part begins.

    Not at once: with a load of any size that swings as it likes, the mass has a velocity that its
    first samples do not show, whatever is missing.
    """
    return [(*values[:-1], 1.0)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Ask for a resonance that a part holds and samples show, and for a spring that is felt.

    In less than a period a load that swings is a force of any size, as a bias is. A weak spring
    with a load that swings widely is a sinusoid, of an amplitude of its own in each part.
    """
    natural_frequency, damping_ratio, stiffness, _ = values
    force = stiffness * span.signals['velocity'] / (TURN * natural_frequency)
    return (1.0 / span.duration < natural_frequency < 0.5 / span.sample_time
            and damping_ratio < RESONANT and force > FELT * span.value)


EFFECT = Effect(
    id='flexible_load',
    title='flexible load',
    kinds=('force',),
    reads=('velocity',),
    parameters=(
        EffectParameter('natural_frequency', 'natural frequency of the load on its spring', 'Hz',
                        1e-3, 1e5),
        EffectParameter('damping_ratio', 'damping over the critical one', '1', 1e-3, 1.0),
        EffectParameter('stiffness', 'stiffness of the spring', 'value/position', 1e-9, 1e15,
                        scales=1),
        EffectParameter('swings_at_start', 'whether it may swing when a recording begins', '1',
                        0.0, 1.0, log=False, refinement=0.0, fixed=True),
    ),
    starts=starts,
    excitation='use steps, or sinusoids around the natural frequency of the load',
    refined=refined,
    distinguishable=distinguishable,
    law=law,
    memory=4,
    swings=2,
    linear=True,
)
