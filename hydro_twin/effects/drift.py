"""A parameter that drifts, as the leakage of oil that warms."""
from __future__ import annotations

import math

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.effects.effect import Course, Effect, EffectParameter, Span, Starts
from hydro_twin.plants.plant import PARAMETER

MIN_FACTOR = 0.2        # of the last value, and its inverse the most: oil ISO VG 46 of viscosity
#                         index 100 that warms from 20 to 50 degrees C is a quarter as viscous
IDLE = (0.33, 0.6)      # shares of the recording before a drift begins, to start a search at
SETTLES = (0.5, 0.2)    # and time constants, in shares of the recording
STRAIGHT = 1e-12        # of a time constant: shorter, a lag is a straight line to rounding
STEP = 1e-6             # of the differences, relative; what is left out is its square

Values = tuple[float, ...]


def factor(values: Values, time: float | FloatArray) -> FloatArray:
    """Return the value at stamps [s] over the last one, between `MIN_FACTOR` and its inverse.

    From b = begin + idle to e = end it goes as 1 - rate (e - b) w, where w falls from 1 to 0 in a
    straight line, or with a time constant as a first-order lag settles.
    """
    rate, idle, time_constant, begin, end = values
    since = begin + idle
    if not since < end:
        return np.ones_like(time)
    spread = end - since
    passed = np.clip(time - since, 0.0, spread)
    if spread < STRAIGHT * time_constant:
        left = 1.0 - passed / spread
    else:
        left = (np.exp(-passed / time_constant) * np.expm1((passed - spread) / time_constant)
                / math.expm1(-spread / time_constant))
    found: FloatArray = np.clip(1.0 - rate * spread * left, MIN_FACTOR, 1.0 / MIN_FACTOR)
    return found


def distinguishable(_: Span, values: Values) -> bool:
    """Separate a drift from what changes the parameter beyond `MIN_FACTOR` or its inverse.

    That acts where the recording begins or ends, and not with time: a dead zone
    that only the first steps are within.
    """
    return MIN_FACTOR < float(factor(values, values[3])) < 1.0 / MIN_FACTOR


def slopes(values: Values, time: FloatArray) -> FloatArray:
    """Differentiate the factor by the parameters, by differences; begin and end are fixed."""
    rate, _, time_constant, begin, end = values

    def slope(index: int, step: float) -> FloatArray:
        above, below = (factor((*values[:index], values[index] + way * step, *values[index + 1:]),
                               time) for way in (1.0, -1.0))
        return (above - below) / (2.0 * step)

    spread = end - begin
    still = np.zeros_like(time)
    return np.stack([
        slope(0, max(STEP * abs(rate), STEP / spread)), slope(1, STEP * spread),
        still if math.isinf(time_constant) else slope(2, STEP * time_constant), still, still])


def interval(values: Values) -> tuple[float, float]:
    """Return the stamps [s] between which the parameter changes."""
    return values[3] + values[1], values[4]


def starts(_: Span) -> Starts:
    """List none: the residual says which parameter drifts, and how fast."""
    return []


def refined(span: Span, values: Values) -> Starts:
    """Begin to drift later, or settle, by as much in all."""
    rate, _, _, begin, end = values
    whole = end - begin
    return [*((rate / (1.0 - share), share * whole, math.inf, begin, end) for share in IDLE),
            *((rate, 0.0, share * whole, begin, end) for share in SETTLES)]


EFFECT = Effect(
    id='drift',
    title='drift',
    kinds=(PARAMETER,),
    parameters=(
        EffectParameter('rate', 'mean change of the parameter in a second, over its last value',
                        '1/s', -1e3, 1e3, log=False),
        EffectParameter('idle', 'how long it keeps its first value', 's', 0.0, 1e9, log=False,
                        refinement=0.0),
        EffectParameter('time_constant', 'with which it settles', 's', 1e-6, math.inf,
                        refinement=math.inf),
        EffectParameter('begin', 'stamp of the first sample recorded', 's', -1e12, 1e12,
                        log=False, fixed=True),
        EffectParameter('end', 'stamp of the last; later the parameter keeps its last value', 's',
                        -1e12, 1e12, log=False, fixed=True),
    ),
    starts=starts,
    refined=refined,
    excitation='record from a cold start until the rig is warm',
    distinguishable=distinguishable,
    course=Course(factor, slopes, interval),
)
