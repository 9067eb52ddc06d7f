"""What a rig may have that five linear laws lack: each drawn from barely visible to dominant."""
from __future__ import annotations

import math

import numpy as np

from benchmarks.tracing.draws import Built, Fields, law, LAWS, Scales, share, sign
from benchmarks.tracing.signals import Generator

# friction, at the motor


@law('single', 'friction')
def coulomb(s: Scales, rng: Generator) -> Fields:
    f = s.torque * share(rng, 0.01, 0.3)
    return {'coulomb': f, 'static': f}


@law('single', 'friction')
def stribeck(s: Scales, rng: Generator) -> Fields:
    f = s.torque * share(rng, 0.01, 0.3)
    return {'coulomb': f, 'static': f * rng.uniform(1.1, 1.6),
            'stribeck': s.omega * share(rng, 0.01, 0.1)}


@law('variant', 'friction')
def lugre(s: Scales, rng: Generator) -> Fields:
    f = s.torque * share(rng, 0.01, 0.3)
    bristle = f / (s.span * share(rng, 0.003, 0.03))
    return {'lugre': 1.0, 'coulomb': f, 'static': f * rng.uniform(1.1, 1.6),
            'stribeck': s.omega * share(rng, 0.01, 0.1), 'bristle': bristle,
            'bristle_damping': 2 * rng.uniform(0.2, 1.0) * math.sqrt(bristle * 0.03)}


@law('variant', 'friction')
def dahl(s: Scales, rng: Generator) -> Fields:
    f = s.torque * share(rng, 0.01, 0.3)
    return {'lugre': 1.0, 'coulomb': f, 'static': f,
            'bristle': f / (s.span * share(rng, 0.003, 0.03))}


@law('variant', 'friction')
def smooth_coulomb(s: Scales, rng: Generator) -> Fields:
    return {'smooth_coulomb': s.torque * share(rng, 0.01, 0.3),
            'smooth_width': s.omega * share(rng, 0.01, 0.1)}


# dead zone: overlap of the spool

@law('single', 'dead_zone')
def overlap(s: Scales, rng: Generator) -> Fields:
    d = s.x * share(rng, 0.005, 0.4)
    return {'dead_low': d, 'dead_high': d}


@law('variant', 'dead_zone')
def soft_overlap(s: Scales, rng: Generator) -> Fields:
    d = s.x * share(rng, 0.01, 0.4)
    return {'dead_low': d, 'dead_high': d, 'dead_corner': d * rng.uniform(0.05, 0.25)}


@law('variant', 'dead_zone')
def uneven_overlap(s: Scales, rng: Generator) -> Fields:
    d = s.x * share(rng, 0.01, 0.4)
    tilt = rng.uniform(-0.4, 0.4)
    return {'dead_low': d * (1 - tilt), 'dead_high': d * (1 + tilt)}


@law('variant', 'dead_zone')
def leaky_overlap(s: Scales, rng: Generator) -> Fields:
    d = s.x * share(rng, 0.02, 0.4)
    return {'dead_low': d, 'dead_high': d, 'dead_slope': rng.uniform(0.05, 0.3)}


@law('variant', 'dead_zone')
def command_overlap(s: Scales, rng: Generator) -> Fields:
    return {'command_dead': s.u * share(rng, 0.01, 0.4)}


# backlash: a gap in the coupling's twist

@law('single', 'backlash')
def gap(s: Scales, rng: Generator) -> Fields:
    return {'gap': s.span * share(rng, 0.002, 0.06)}


@law('variant', 'backlash')
def gap_on_flank(s: Scales, rng: Generator) -> Fields:
    half = s.span * share(rng, 0.002, 0.06)
    return {'gap': half, 'gap_centre': half * sign(rng)}


@law('variant', 'backlash')
def damped_gap(s: Scales, rng: Generator) -> Fields:
    return {'gap': s.span * share(rng, 0.002, 0.06), 'contact_damping': share(rng, 0.3, 10.0)}


@law('variant', 'backlash')
def sprung_gap(s: Scales, rng: Generator) -> Fields:
    return {'gap': s.span * share(rng, 0.004, 0.06), 'gap_stiffness': share(rng, 100.0, 1500.0)}


# saturation

@law('single', 'saturation')
def window_end(s: Scales, rng: Generator) -> Fields:
    return {'stroke': s.x * rng.uniform(0.4, 0.97)}


@law('single', 'saturation')
def command_limit(s: Scales, rng: Generator) -> Fields:
    return {'command_limit': s.u * rng.uniform(0.4, 0.97)}


@law('variant', 'saturation')
def hard_stop(s: Scales, rng: Generator) -> Fields:
    return {'stop': s.x * rng.uniform(0.4, 0.95)}


@law('variant', 'saturation')
def rounded_end(s: Scales, rng: Generator) -> Fields:
    return {'stroke': s.x * rng.uniform(0.4, 0.9), 'stroke_power': rng.uniform(6.0, 15.0)}


# rate limit

@law('single', 'rate_limit')
def spool_rate(s: Scales, rng: Generator) -> Fields:
    return {'rate': s.x_rate * rng.uniform(0.2, 0.9)}


@law('variant', 'rate_limit')
def soft_spool_rate(s: Scales, rng: Generator) -> Fields:
    return {'rate': s.x_rate * rng.uniform(0.2, 0.9), 'rate_softness': 1.0}


@law('variant', 'rate_limit')
def command_slew(s: Scales, rng: Generator) -> Fields:
    return {'command_slew': s.x_rate * s.u / s.x * rng.uniform(0.2, 0.9)}


# hysteresis

@law('single', 'hysteresis')
def command_play(s: Scales, rng: Generator) -> Fields:
    return {'command_play': s.u * share(rng, 0.005, 0.25)}


@law('single', 'hysteresis')
def spool_play(s: Scales, rng: Generator) -> Fields:
    return {'play': s.x * share(rng, 0.005, 0.25)}


@law('variant', 'hysteresis')
def bouc_wen(s: Scales, rng: Generator) -> Fields:
    return {'bouc_wen': s.x * share(rng, 0.01, 0.25), 'bouc_wen_power': rng.uniform(1.0, 3.0)}


@law('variant', 'hysteresis')
def prandtl_ishlinskii(s: Scales, rng: Generator) -> Fields:
    return {'command_play': s.u * share(rng, 0.01, 0.25),
            'command_play_spread': rng.uniform(0.3, 1.0)}


@law('variant', 'hysteresis')
def switching(s: Scales, rng: Generator) -> Fields:
    height = s.u * share(rng, 0.01, 0.15)
    return {'relay_height': height, 'relay_width': height * rng.uniform(0.5, 3.0)}


# delay of the command

@law('single', 'delay')
def pure_delay(_: Scales, rng: Generator) -> Fields:
    return {'delay': share(rng, 0.002, 0.02)}


@law('variant', 'delay')
def pade_delay(_: Scales, rng: Generator) -> Fields:
    return {'delay': share(rng, 0.003, 0.02), 'delay_kind': 'pade'}


@law('variant', 'delay')
def lag_chain(_: Scales, rng: Generator) -> Fields:
    return {'delay': share(rng, 0.003, 0.02), 'delay_kind': 'lags'}


# asymmetry of the flow gain

@law('single', 'asymmetry')
def uneven_gain(_: Scales, rng: Generator) -> Fields:
    return {'asymmetry': sign(rng) * share(rng, 0.005, 0.4)}


@law('variant', 'asymmetry')
def rounded_uneven_gain(s: Scales, rng: Generator) -> Fields:
    return {'asymmetry': sign(rng) * share(rng, 0.01, 0.4),
            'asymmetry_width': s.x * rng.uniform(0.03, 0.2)}


@law('variant', 'asymmetry')
def skewed_gain(s: Scales, rng: Generator) -> Fields:
    return {'skew': sign(rng) * share(rng, 0.01, 0.4) / s.x}


# bias

@law('single', 'bias')
def null_shift(s: Scales, rng: Generator) -> Fields:
    return {'command_bias': sign(rng) * s.u * share(rng, 0.003, 0.2)}


@law('single', 'bias')
def torque_bias(s: Scales, rng: Generator) -> Fields:
    return {'torque_bias': sign(rng) * s.torque * share(rng, 0.003, 0.2)}


@law('single', 'bias')
def sensor_bias(s: Scales, rng: Generator) -> Fields:
    return {'sensor_bias': sign(rng) * s.torque * share(rng, 0.003, 0.2)}


# orifice: flow falls with load pressure

@law('single', 'orifice')
def square_root(s: Scales, rng: Generator) -> Fields:
    supply = s.p / share(rng, 0.1, 0.95)
    return {'supply_high': supply, 'supply_low': supply}


@law('variant', 'orifice')
def two_supplies(s: Scales, rng: Generator) -> Fields:
    supply = s.p / share(rng, 0.15, 0.9)
    tilt = rng.uniform(-0.2, 0.2)
    return {'supply_high': supply * (1 + tilt), 'supply_low': supply * (1 - tilt)}


@law('variant', 'orifice')
def other_power(s: Scales, rng: Generator) -> Fields:
    supply = s.p / share(rng, 0.15, 0.9)
    return {'supply_high': supply, 'supply_low': supply,
            'orifice_power': rng.choice((rng.uniform(0.4, 0.46), rng.uniform(0.54, 0.65)))}


# leakage other than laminar: sized against the flow a laminar one would lose at the peak

@law('single', 'leakage')
def turbulent(s: Scales, rng: Generator) -> Fields:
    return {'leak_root': 5.0e-12 * math.sqrt(s.p) * share(rng, 0.03, 3.0)}


@law('variant', 'leakage')
def squared(s: Scales, rng: Generator) -> Fields:
    return {'leak_square': 5.0e-12 / s.p * share(rng, 0.03, 3.0)}


@law('variant', 'leakage')
def relief(s: Scales, rng: Generator) -> Fields:
    return {'relief': s.p * rng.uniform(0.3, 0.8), 'relief_slope': share(rng, 1.0e-12, 2.0e-11)}


# stiffening of the coupling: sized by the rise of the stiffness at the peak

@law('single', 'stiffening')
def cubic(s: Scales, rng: Generator) -> Fields:
    return {'cubic': share(rng, 0.1, 5.0) * (1.0e4 / s.torque) ** 2}


@law('variant', 'stiffening')
def quadratic(s: Scales, rng: Generator) -> Fields:
    return {'quadratic': share(rng, 0.1, 5.0) * 1.0e4 / s.torque}


@law('variant', 'stiffening')
def knee(s: Scales, rng: Generator) -> Fields:
    return {'knee': s.torque / 1.0e4 * rng.uniform(0.2, 0.7),
            'knee_stiffness': 1.0e4 * share(rng, 0.3, 5.0)}


# ripple

@law('single', 'ripple')
def sine_ripple(s: Scales, rng: Generator) -> Fields:
    return {'ripple': s.torque * share(rng, 0.005, 0.2),
            'ripple_order': float(rng.integers(5, 41)), 'ripple_phase': rng.uniform(0, 2 * np.pi)}


# outside any library

@law('outside', 'soft_flow')
def tanh_flow(s: Scales, rng: Generator) -> Fields:
    return {'flow_tanh': s.x * share(rng, 0.3, 3.0)}


@law('outside', 'soft_flow')
def rational_flow(s: Scales, rng: Generator) -> Fields:
    return {'stroke': s.x * share(rng, 0.5, 10.0), 'stroke_power': 1.0}


@law('outside', 'progressive_flow')
def progressive_flow(s: Scales, rng: Generator) -> Fields:
    return {'progressive': share(rng, 0.05, 2.0) / s.x}


@law('outside', 'aerated_oil')
def two_chambers(s: Scales, rng: Generator) -> Fields:
    return {'gas': share(rng, 0.1, 5.0), 'mean_pressure': s.p * rng.uniform(0.55, 1.0)}


@law('outside', 'aerated_oil')
def air_at_low_pressure(s: Scales, rng: Generator) -> Fields:
    return {'air': share(rng, 0.5, 30.0), 'air_pressure': s.p * share(rng, 0.05, 0.4)}


@law('outside', 'pressure_damping')
def pressure_damping(s: Scales, rng: Generator) -> Fields:
    return {'pressure_damping': share(rng, 0.2, 10.0) / s.p}


@law('outside', 'quadratic_drag')
def quadratic_drag(s: Scales, rng: Generator) -> Fields:
    return {'drag': 50.0 * share(rng, 0.1, 5.0) / s.omega}


@law('outside', 'load_friction')
def load_friction(_: Scales, rng: Generator) -> Fields:
    return {'load_friction': share(rng, 0.01, 0.3)}


@law('outside', 'line')
def mains_line(s: Scales, rng: Generator) -> Fields:
    return {'line': s.torque * share(rng, 0.005, 0.1), 'line_hz': 50.2}


@law('outside', 'resonance')
def sensor_mode(_: Scales, rng: Generator) -> Fields:
    return {'mode': 2 * np.pi * rng.uniform(15.0, 60.0), 'mode_damping': share(rng, 0.02, 0.3)}


@law('outside', 'gain_drift')
def gain_drift(s: Scales, rng: Generator) -> Fields:
    return {'gain_drift': share(rng, 0.02, 0.3),
            'gain_drift_rate': 2 * np.pi * rng.uniform(0.3, 2.0) / s.duration}


@law('outside', 'leak_drift')
def warming_oil(s: Scales, rng: Generator) -> Fields:
    return {'leak_drift': share(rng, 0.05, 2.0) / s.duration}


@law('outside', 'disturbance')
def coloured_disturbance(s: Scales, rng: Generator) -> Fields:
    return {'disturbance': s.torque * share(rng, 0.005, 0.05),
            'disturbance_memory': rng.uniform(0.8, 0.99)}


@law('outside', 'burst')
def high_frequency_burst(s: Scales, rng: Generator) -> Fields:
    return {'burst': s.torque * share(rng, 0.02, 0.2), 'burst_hz': rng.uniform(60.0, 150.0)}


EFFECTS, VARIED, OUTSIDE = (tuple(LAWS[kind]) for kind in ('single', 'variant', 'outside'))

# Outside any library, but a static law at one port: where it may be seen, as kind of port and
# signal. The flow and the opening differ by a factor. Oil that is soft at low pressure gives
# another pressure for what has flowed in; of it the torque and the leakage follow.
_OPENING = {('flow', 'opening'), ('flow', 'value'), ('opening', 'value')}
_PRESSURE = {('pressure', 'load_pressure'), ('pressure', 'value'), ('leakage', 'load_pressure'),
             ('leakage', 'value'), ('flow', 'load_pressure'), ('force', 'value')}
STATIC = {'soft_flow': _OPENING, 'progressive_flow': _OPENING, 'aerated_oil': _PRESSURE,
          'quadratic_drag': {('force', 'velocity')}}


def draw(kind: str, effect: str, scales: Scales, rng: Generator) -> Built:
    """Draw one of the laws for an effect, and its strength."""
    laws = LAWS[kind][effect]
    name, of = laws[rng.integers(len(laws))]
    return Built(effect, name, of(scales, rng))
