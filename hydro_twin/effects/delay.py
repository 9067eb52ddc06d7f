"""Dead time between the command and the valve."""
from __future__ import annotations

from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts


def starts(span: Span) -> Starts:
    """Delays from one sample up."""
    return [(samples * span.sample_time,) for samples in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)]


EFFECT = Effect(
    id='delay',
    title='delay',
    kinds=('command',),
    parameters=(EffectParameter('time', 'dead time: u(t - time)', 's', 1e-6, 1e2),),
    starts=starts,
    excitation='use steps or fast sinusoids',
    confounded=True,
    linear=True,
    dynamic=True,
    shifts='held',
)
