"""Mode of a command: a stage of second order before the valve."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Quantity, Span, Starts

SMALL = 1e-3            # [rad] of a step, below which its ends describe it
TURN = 2.0 * math.pi    # [rad]
CRITICAL = 0.99         # damping ratio from which a mode is two equal lags


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give y of y'' + 2 damping w y' + w^2 y = w^2 v, w = 2 pi natural_frequency, from rest.

    Exact for a command held over a step. z is y, y' / w and the length of the steps, zero before
    the first. What leaves the port is taken as linear over a step. This is the line with the
    mean and the first moment of the true course, so that a step may be longer than a period.
    """
    if z[2] == 0.0:
        z_next[0] = v
        z_next[1] = 0.0
        z_next[2] = h
        return v
    damping = p[1]
    a = TURN * p[0] * (h if h > 0.0 else z[2])
    root = math.sqrt(max(1.0 - damping * damping, 1e-12))
    decay = math.exp(-damping * a)
    cosine = decay * math.cos(root * a)
    sine = decay * math.sin(root * a) / root
    off = z[0] - v
    speed = z[1]
    off_end = (cosine + damping * sine) * off + sine * speed
    speed_end = (cosine - damping * sine) * speed - sine * off
    if h > 0.0:
        z_next[0] = v + off_end
        z_next[1] = speed_end
    if a < SMALL:
        return v + (off_end if h > 0.0 else off)
    mean = (2.0 * damping * (off - off_end) + speed - speed_end) / a
    speed_mean = (off_end - off) / a
    moment = (2.0 * damping * (mean - off_end) + speed_mean - speed_end) / a
    return v + (6.0 * moment - 2.0 * mean if h > 0.0 else 4.0 * mean - 6.0 * moment)


def starts(span: Span) -> Starts:
    """Natural frequencies down from a third of the sampling rate, well and lightly damped."""
    return [(1.0 / (samples * span.sample_time), damping)
            for samples in (3.0, 6.0, 12.0, 24.0, 48.0) for damping in (0.7, 0.15)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Separate a mode from two equal lags, and from one above half of the sampling rate."""
    natural_frequency, damping_ratio = values
    return natural_frequency * span.sample_time < 0.5 and damping_ratio < CRITICAL


EFFECT = Effect(
    id='mode',
    title='second-order mode',
    kinds=('command',),
    parameters=(
        EffectParameter('natural_frequency', 'undamped natural frequency', 'Hz', 1e-3, 1e5),
        EffectParameter('damping_ratio', 'damping over the critical one', '1', 1e-3, 1.0),
    ),
    starts=starts,
    excitation='use steps, or sinusoids up to the frequency of the mode',
    distinguishable=distinguishable,
    confounded=True,
    linear=True,
    dynamic=True,
    simpler='lag',
    law=law,
    memory=3,
    shows=(Quantity('output', 'value', lambda _: {0: 1.0}),),
)
