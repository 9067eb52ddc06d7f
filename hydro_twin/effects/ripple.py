"""Ripple: torque that is periodic in the angle of the motor, as each piston gives it."""
from __future__ import annotations

import math

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts

FEWEST = 5.0            # periods a turn of a coarse motor
LEAST = 0.1             # of a period, over which a sine is a parabola: a bias and a spring make up
#                         for most of it
PARTS = (0.2, 0.35)     # of a period to start from; from the last on in equal steps
SHAPE = 2.0             # periods, in less of which harmonics would fit any shape: that it repeats
#                         is not seen
GRAVITY = (1.0, 2.0)    # periods a turn of a load that hangs on the axis
FIRST, LAST = 3.0, 63.0     # the same of what ripples more often, to start from
NO_HARMONICS = (0.0, 0.0, 0.0, 0.0)


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Give v + sum over k of cosine_k cos(k n position) + sine_k sin(k n position), k to 3.

    n is the number of periods a turn (2 pi).
    """
    angle = p[2] * s[0]
    rippled = v + p[0] * math.cos(angle) + p[1] * math.sin(angle)
    if p[3] != 0.0 or p[4] != 0.0:
        rippled += p[3] * math.cos(2.0 * angle) + p[4] * math.sin(2.0 * angle)
    if p[5] != 0.0 or p[6] != 0.0:
        rippled += p[5] * math.cos(3.0 * angle) + p[6] * math.sin(3.0 * angle)
    return rippled


def starts(span: Span) -> Starts:
    """Every number of periods that the movement can resolve, in both phases."""
    travel = max(span.travel['position'], 1e-9)
    step = min(max(1.0 / travel, 0.5), 6.0)
    parts = [2.0 * math.pi * part / travel for part in PARTS]
    steps = [FIRST + step * k for k in range(int((LAST - FIRST) / step))]
    small = 0.03 * span.value
    return [values for periods in (*(few for few in parts if FIRST <= few < LAST),
                                   *(many for many in (*GRAVITY, *steps)
                                     if _seen(span, many) > PARTS[-1]))
            for values in ((small, 0.0, periods, *NO_HARMONICS),
                           (0.0, small, periods, *NO_HARMONICS))]


def refined(span: Span, values: tuple[float, ...]) -> Starts:
    """Let in harmonics; what was found may be one itself."""
    cosine, sine, periods, *_ = values
    small = 0.1 * math.hypot(cosine, sine)
    return [forms for forms in ((cosine, sine, periods, small, small, small, small),
                                (small, small, periods / 2.0, cosine, sine, small, small))
            if _seen(span, forms[2]) > SHAPE]


def plain(values: tuple[float, ...]) -> tuple[float, ...]:
    """Take the strongest harmonic alone, as what repeats."""
    cosine, sine, periods, *harmonics = values
    waves = [(cosine, sine), tuple(harmonics[:2]), tuple(harmonics[2:])]
    k = max(range(len(waves)), key=lambda k: math.hypot(*waves[k]))
    return (*waves[k], (k + 1) * periods, *NO_HARMONICS)


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Less than a tenth of a period is a bias, or a spring, for all one can see."""
    return _seen(span, values[2]) > LEAST


def _seen(span: Span, periods: float) -> float:
    """Count the periods passed over the travel, at so many periods a turn."""
    return periods * span.travel['position'] / (2.0 * math.pi)


def passes_for(span: Span) -> str:
    """Say what it looks like where the motor hardly turns: a constant torque."""
    return '' if distinguishable(span, (0.0, 0.0, FEWEST)) else 'bias'


EFFECT = Effect(
    id='ripple',
    title='torque ripple',
    kinds=('force',),
    reads=('position',),
    unit_read='rad',
    parameters=(
        EffectParameter('cosine', 'amplitude in cosine phase', 'value', -1e9, 1e9, log=False,
                        scales=1),
        EffectParameter('sine', 'amplitude in sine phase', 'value', -1e9, 1e9, log=False,
                        scales=1),
        EffectParameter('periods', 'periods a turn', '1', 0.1, 1e3, log=False),
        *(EffectParameter(f'{phase}_{k}', f'that of {k} times the periods', 'value', -1e9, 1e9,
                          log=False, refinement=0.0, scales=1)
          for k in (2, 3) for phase in ('cosine', 'sine')),
    ),
    starts=starts,
    excitation='turn the motor slowly through several periods',
    confounded=True,
    periodic=True,
    refined=refined,
    plain=plain,
    distinguishable=distinguishable,
    passes_for=passes_for,
    law=law,
)
