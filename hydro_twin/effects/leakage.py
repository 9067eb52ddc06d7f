"""Leakage other than laminar."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.effect import Effect, EffectParameter, Span, Starts

REFERENCE = 1e6                             # [Pa]
NEARLY = 0.15                               # of an exponent: nearer to 1 it is laminar


@compiled
def law(v, s, p, z, h, c, z_next):  # type: ignore[no-untyped-def]
    """Add to the laminar leakage flow sign(p_L) (|p_L| / 1 MPa)^exponent.

    Exponent 1/2 is a sharp-edged orifice [Merritt 1967, eq. 3-33]; above 1, a gap that widens
    under pressure.
    """
    flow, exponent, load_pressure = p[0], p[1], s[0]
    extra = flow * (abs(load_pressure) / REFERENCE) ** exponent
    return v + extra if load_pressure > 0.0 else v - extra


def starts(span: Span) -> Starts:
    """Begin with a share of the largest laminar leakage, turbulent and widening."""
    pressure = max(span.signals['load_pressure'], 1.0) / REFERENCE
    return [(share * span.value / pressure**exponent, exponent)
            for exponent in (0.5, 2.0, 3.0) for share in (0.1, 0.5)]


def distinguishable(span: Span, values: tuple[float, ...]) -> bool:
    """Refuse an exponent near that of laminar flow: there it imitates something else."""
    return abs(values[1] - 1.0) > NEARLY


EFFECT = Effect(
    id='leakage',
    title='leakage other than laminar',
    countable=False,
    kinds=('leakage',),
    reads=('load_pressure',),
    parameters=(
        EffectParameter('flow', 'extra flow at 1 MPa', 'value', 1e-15, 1e3, scales=1),
        EffectParameter('exponent', 'power of the pressure', '1', 0.2, 4.0, log=False),
    ),
    starts=starts,
    excitation='hold high load pressure, both ways',
    distinguishable=distinguishable,
    law=law,
)
