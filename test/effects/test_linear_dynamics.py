"""Lag, mode and flexible load against scipy, which knows plant and these as one linear system."""
from dataclasses import replace
import math

import numpy as np
import pytest
from scipy import signal

from hydro_twin.effects import EFFECTS, Span
from hydro_twin.fitting.output_error import fitted_residuals
from hydro_twin.fitting.parts import Part
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.system import assemble

PLANT = PLANTS['load_simulator']
VALUES = PLANT.constant_values() | {p.name: (p.lower * p.upper) ** 0.5 for p in PLANT.parameters}
T = PLANT.sample_time
SCALE = np.diag([1e-5, 1e6, 1.0, 1e-2])     # of the states, whose units differ much
FILTERS = [
    ('lag', {'time_constant': 0.01}),
    ('lag', {'time_constant': 1e-3}),
    ('lag', {'time_constant': 2e-6}),       # much shorter than any step
    ('mode', {'natural_frequency': 100.0, 'damping_ratio': 0.7}),
    ('mode', {'natural_frequency': 20.0, 'damping_ratio': 0.1}),
    ('mode', {'natural_frequency': 30.0, 'damping_ratio': 1.0}),
    ('mode', {'natural_frequency': 2000.0, 'damping_ratio': 0.7}),      # turns within a step
]
DYNAMIC = [e for e in EFFECTS if e.id in ('lag', 'mode')]


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def filtered(name, p):
    """Write a filter as x' = A x + B v, y = C x."""
    if name == 'lag':
        numerator, denominator = [1.0], [p['time_constant'], 1.0]
    else:
        w = 2 * math.pi * p['natural_frequency']
        numerator, denominator = [1.0], [1 / w**2, 2 * p['damping_ratio'] / w, 1.0]
    return signal.tf2ss(numerator, denominator)[:3]


def inputs_of(samples=600):
    """Draw steps of the command, and a shaft that begins to turn smoothly."""
    t = T * np.arange(samples)
    u = np.repeat(0.3 * np.random.default_rng(0).standard_normal(samples // 6), 6)
    u[:6] = 0.0
    return np.column_stack([u, 0.02 * np.sin(2 * np.pi * 3 * t) * -np.expm1(-(t / 0.1) ** 2)])


def exact(inputs, port, name, p):
    """Solve plant and filter as one: the command held, the angle linear between samples."""
    laws = PLANT.laws(VALUES)
    A, B = np.linalg.solve(SCALE, laws.A @ SCALE), np.linalg.solve(SCALE, laws.B)
    C, D = laws.C @ SCALE, laws.D
    F, G, K = filtered(name, p)
    n, m = len(A), len(F)
    if port == 'command':
        A = np.block([[A, B[:, [0]] @ K], [np.zeros((m, n)), F]])
        B = np.block([[np.zeros((n, 1)), B[:, [1]]], [G, np.zeros((m, 1))]])
        C = np.hstack([C, D[:, [0]] @ K])
    else:
        A = np.block([[A, np.zeros((n, m))], [G @ C, F]])
        B, C, D = np.vstack([B, G @ D]), np.hstack([np.zeros((1, n)), K]), np.zeros((1, 2))
    y = np.zeros(len(inputs))
    for j, how in enumerate(('zoh', 'foh')):
        discrete = signal.cont2discrete((A, B[:, [j]], C, D[:, [j]]), T, how)
        y += signal.dlsim(discrete, inputs[:, j])[1][:, 0]
    return y


@pytest.mark.parametrize(('name', 'p'), FILTERS, ids=lambda one: str(one))
@pytest.mark.parametrize(('substeps', 'at_command', 'at_sensor'), [
    (1, 5e-5, 5e-3), (4, 2e-6, 3e-4), (16, 1e-8, 2e-5)])
def test_plant_and_filter_are_one_linear_system(name, p, substeps, at_command, at_sensor):
    """RMS, as a share of the output's.

    At the command only what the filter does within a step is taken as linear, at the sensor what
    the plant does, which is less smooth after a step of the command.
    """
    inputs = inputs_of()
    for port, tolerance in (('command', at_command), ('sensor', at_sensor)):
        expected = exact(inputs, port, name, p)
        found = assemble(PLANT, VALUES, [place(name, port, p, PLANT)], T, substeps).run(
            inputs, np.zeros(4))
        assert rms(found - expected) < tolerance * rms(expected)


@pytest.mark.parametrize('effect', DYNAMIC, ids=lambda e: f'{e.id}-{e.kinds[0]}')
@pytest.mark.parametrize('h', [1e-4, 2e-3, 5e-2])
def test_laws_are_exact_at_the_ends_of_steps_of_any_length(effect, h):
    """Under a value that is held over each step, or, at a sensor, linear over it."""
    rng = np.random.default_rng(1)
    p = {'time_constant': 0.01} if effect.id == 'lag' else {
        'natural_frequency': 25.0, 'damping_ratio': 0.3}
    held = effect.kinds == ('command',)
    v = np.concatenate([np.zeros(2), rng.standard_normal(40)])
    discrete = signal.cont2discrete((*filtered(effect.id, p), np.zeros((1, 1))), h,
                                    'zoh' if held else 'foh')
    expected = signal.dlsim(discrete, np.append(v, v[-1]))[1][:, 0]
    z, kept, s = np.zeros(effect.memory), [], np.zeros(2)
    for value in v:
        z_next = z.copy()
        end = effect.law(value, s, np.array(list(p.values())), z, h, 0.0, z_next)
        z = z_next
        kept.append(z[0] if held else end)
    np.testing.assert_allclose(kept, expected[1:] if held else expected[:-1], atol=1e-11)


@pytest.mark.parametrize('port', ['command', 'sensor'])
@pytest.mark.parametrize(('name', 'p'), FILTERS[:5], ids=lambda one: str(one))
def test_at_rest_nothing_is_gained_or_lost(port, name, p):
    """A run that starts settled stays there, and ends where the linear plant ends."""
    system = assemble(PLANT, VALUES, [place(name, port, p, PLANT)], T)
    still = np.tile([0.2, 0.01], (1000, 1))
    linear = assemble(PLANT, VALUES, [], T).run(np.tile([0.2, 0.01], (8000, 1)), np.zeros(4))[-1]
    x = system.start(still[0], linear)
    np.testing.assert_allclose(system.run(still, x), linear, rtol=1e-6)
    edges, = system.memory_edges(still[:1], x[None])
    assert np.ptp(edges, axis=1) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize('port', ['command', 'sensor'])
@pytest.mark.parametrize('substeps', [1, 4, 16])
def test_a_time_constant_that_vanishes_leaves_the_plant(port, substeps):
    inputs = inputs_of()
    linear = assemble(PLANT, VALUES, [], T).run(inputs, np.zeros(4))

    def off(time_constant):
        lag = place('lag', port, {'time_constant': 1e-6}, PLANT)
        placed = replace(lag, values=(time_constant,))
        return rms(assemble(PLANT, VALUES, [placed], T, substeps).run(inputs, np.zeros(4))
                   - linear) / rms(linear)

    assert off(1e-6) < 1e-4
    assert off(1e-12) < 1e-9
    assert off(1e-3) > 1e-2


@pytest.mark.parametrize('effect', [e for e in DYNAMIC if e.id == 'mode'], ids=lambda e: e.kinds)
def test_a_mode_above_half_of_the_sampling_rate_is_none_that_a_recording_shows(effect):
    reach = Span(((-1.0, 1.0),), {}, (-1.0, 1.0), 0.002, 10)
    assert effect.distinguishable(reach, (240.0, 0.1))
    assert not effect.distinguishable(reach, (260.0, 0.1))


AXIS = PLANTS['rotary_axis']
AXIS_VALUES = {'J': 2.0, 'B': 3.0}
LOADS = [(6.0, 0.02, 1.5), (20.0, 0.3, 0.4), (3.0, 1.0, 5.0)]      # [Hz], [1], inertia [kg m^2]


def two_masses(frequency, damping, inertia):
    """Write J omega' = torque - B omega + s, e'' = -s / inertia - omega' with a spring's s.

    The states are omega, theta, and the stretch of the spring e with its speed.
    """
    w = 2 * math.pi * frequency
    spring = inertia * np.array([0.0, 0.0, w**2, 2 * damping * w])
    omega = (np.array([-AXIS_VALUES['B'], 0.0, 0.0, 0.0]) + spring) / AXIS_VALUES['J']
    A = np.vstack([omega, [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], -spring / inertia - omega])
    B = np.array([[1.0], [0.0], [0.0], [-1.0]]) / AXIS_VALUES['J']
    return A, B, np.array([[0.0, 1.0, 0.0, 0.0]]), np.zeros((1, 1))


def axis_with(load, substeps=1, sample_time=0.002):
    """Assemble the axis with a flexible load."""
    frequency, damping, inertia = load
    placed = place('flexible_load', 'motor', {
        'natural_frequency': frequency, 'damping_ratio': damping,
        'stiffness': inertia * (2 * math.pi * frequency)**2, 'swings_at_start': 1.0}, AXIS)
    return assemble(AXIS, AXIS_VALUES, [placed], sample_time, substeps)


@pytest.mark.parametrize('load', LOADS, ids=str)
@pytest.mark.parametrize(('substeps', 'tolerance'), [(1, 5e-3), (4, 4e-4), (16, 3e-5)])
def test_axis_and_flexible_load_are_one_linear_system(load, substeps, tolerance):
    torque = inputs_of()[:, :1]
    discrete = signal.cont2discrete(two_masses(*load), 0.002, 'zoh')
    expected = signal.dlsim(discrete, torque)[1][:, 0]
    found = axis_with(load, substeps).run(torque, np.zeros(2))
    assert rms(found - expected) < tolerance * rms(expected)


@pytest.mark.parametrize('load', LOADS, ids=str)
def test_a_run_may_begin_while_the_load_swings(load):
    """The memory is the stretch of the spring, and its speed over w.

    In the first of the 16 parts of a sample the axis is taken to move at a constant speed.
    """
    system, e, rate = axis_with(load, 16), 0.02, 0.3
    z = np.zeros(system.memory)
    z[:2] = e, rate / (2 * math.pi * load[0])
    found = system.run(np.zeros((400, 1)), np.zeros(2), z)
    A, B, C, D = two_masses(*load)
    _, expected, _ = signal.lsim((A, B, C, D), None, 0.002 * np.arange(400),
                                 [0.0, 0.0, e, rate])
    assert rms(found - expected) < 0.05 * rms(expected)


def test_initial_states_of_a_swinging_load_are_found():
    """In windows of a run that began long before; if it had to be at rest, ten times is left."""
    system = axis_with(LOADS[0])
    torque = inputs_of()[:, :1]
    clean = system.run(torque, np.zeros(2))
    model = Model(AXIS, AXIS_VALUES, 0.002, system.placed)
    parts = [Part(torque[begin:begin + 150], clean[begin:begin + 150]) for begin in (200, 350)]
    left = rms(np.concatenate(fitted_residuals(model, parts)))
    assert left < 1e-4 * rms(clean)
    settled = replace(system.placed[0], values=(*system.placed[0].values[:-1], 0.0))
    without = replace(model, effects=(settled,))
    assert rms(np.concatenate(fitted_residuals(without, parts))) > 10 * left
