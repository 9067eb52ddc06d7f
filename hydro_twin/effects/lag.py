"""Lag of a command: a stage before the valve that follows it with a time constant."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Quantity, Span, Starts

SMALL = 1e-3            # step over time constant below which the values at its ends are used


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give y of time_constant y' + y = v, from rest; exact for a command held over a step.

    z is y and the step length, zero before the first step. The output of the port is taken as
    linear over a step: the line has the mean and the first moment of the exact response, so that a
    step may be longer than the time constant.
    """
    if z[1] == 0.0:
        z_next[0] = v
        z_next[1] = h
        return v
    a = (h if h > 0.0 else z[1]) / p[0]
    off = z[0] - v
    end = math.exp(-a)
    if h > 0.0:
        z_next[0] = v + off * end
    if a < SMALL:
        return v + off * (end if h > 0.0 else 1.0)
    mean = (1.0 - end) / a
    moment = (mean - end) / a
    return v + off * (6.0 * moment - 2.0 * mean if h > 0.0 else 4.0 * mean - 6.0 * moment)


def starts(span: Span) -> Starts:
    """Time constants from one sample up."""
    return [(samples * span.sample_time,) for samples in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)]


EFFECT = Effect(
    id='lag',
    title='lag',
    kinds=('command',),
    parameters=(EffectParameter('time_constant', 'time constant of the lag', 's', 1e-6, 1e2),),
    starts=starts,
    excitation='use steps or fast sinusoids',
    confounded=True,
    linear=True,
    dynamic=True,
    law=law,
    memory=2,
    shows=(Quantity('output', 'value', lambda _: {0: 1.0}),),
)
