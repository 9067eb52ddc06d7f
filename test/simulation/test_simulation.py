import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydro_twin.errors import UserError
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.simulation.simulate import simulate

VECTOR = {'V_m': 1.75e-4, 'J': 5.5e-2, 'K_p': 1.75e-2, 'K_q': 1.35, 'G': 1.1e4, 'K_ce': 5.5e-12,
          'B_m': 55.0, 'K_sv': 1.15e-4, 'beta_e': 7e8}
D_M = 2e-5
RIG = PLANTS['load_simulator']
T = RIG.sample_time


def u_m(t):
    return 0.3 * np.sin(2 * np.pi * 5.0 * t)


def theta_d(t):
    return 0.01 * np.sin(2 * np.pi * 2.0 * t) ** 3


def rig(effects=(), duration=0.5):
    placed = [place(name, port, parameters, RIG) for name, port, parameters in effects]
    return simulate(RIG, VECTOR | {'D_m': D_M}, placed, {'u_m': u_m, 'theta_d': theta_d}, duration)


def by_scipy(flow=lambda opening, p_L: VECTOR['K_q'] * opening,
             leakage=lambda p_L: VECTOR['K_ce'] * p_L,
             coupling=lambda twist: VECTOR['G'] * twist,
             motor=lambda omega, theta: 0.0, duration=0.5):
    """Integrate the laws of [B19], with laws of one's own, between the samples of u_m."""
    v = VECTOR

    def rates(t, x, u):
        x_v, p_L, omega, theta = x[0] * 1e-5, x[1] * 1e6, x[2], x[3]
        twist = theta - theta_d(t)
        p_rate = 4 * v['beta_e'] / v['V_m'] * (flow(x_v, p_L) - leakage(p_L) - D_M * omega)
        acceleration = (D_M * p_L - v['B_m'] * omega + motor(omega, theta) - coupling(twist)
                        ) / v['J']
        return [(v['K_sv'] * u - x_v) / v['K_p'] * 1e5, p_rate * 1e-6, acceleration, omega]

    x = np.zeros(4)
    torque = [coupling(0.0)]
    for k in range(round(duration / T) - 1):
        x = solve_ivp(rates, (k * T, (k + 1) * T), x, 'DOP853', args=(u_m(k * T),),
                      rtol=1e-10, atol=1e-11).y[:, -1]
        torque.append(coupling(x[3] - theta_d((k + 1) * T)))
    return np.array(torque)


def orifice(opening, p_L):
    return VECTOR['K_q'] * opening * math.sqrt(1 - math.copysign(p_L, p_L * opening) / 12e6)


@pytest.mark.parametrize(('effects', 'laws'), [
    ([], {}),
    ([('orifice', 'flow', {'supply_pressure': 12e6})], {'flow': orifice}),
    ([('asymmetry', 'flow', {'imbalance': 0.2})],
     {'flow': lambda x_v, p_L: VECTOR['K_q'] * (x_v + 0.2 * abs(x_v))}),
    ([('leakage', 'leakage', {'flow': 1e-6, 'exponent': 2.0})],
     {'leakage': lambda p_L: VECTOR['K_ce'] * p_L + 1e-6 * (p_L / 1e6) * abs(p_L / 1e6)}),
    ([('stiffening', 'coupling', {'cubic': 3e3})],
     {'coupling': lambda twist: VECTOR['G'] * (twist + 3e3 * twist ** 3)}),
    ([('backlash', 'coupling', {'gap': 1e-3})],
     {'coupling': lambda twist: VECTOR['G'] * (twist - min(max(twist, -1e-3), 1e-3))}),
    ([('ripple', 'motor', {'cosine': 3.0, 'sine': 2.0, 'periods': 9.0})],
     {'motor': lambda omega, theta: 3.0 * math.cos(9 * theta) + 2.0 * math.sin(9 * theta)}),
], ids=['linear', 'orifice', 'asymmetry', 'leakage', 'stiffening', 'backlash', 'ripple'])
def test_agrees_with_scipy_on_the_laws_written_out(effects, laws):
    expected = by_scipy(**laws)
    found = rig(effects)['T_g']
    assert np.abs(expected).max() > 20.0
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.abs(expected).max())


def test_samples_what_the_plant_got():
    series = rig()
    t = T * np.arange(250)
    assert len(series) == 250
    np.testing.assert_array_equal(series['u_m'], u_m(t))
    np.testing.assert_array_equal(series['theta_d'], theta_d(t))
    assert series['T_g'][0] == 0.0


@pytest.mark.parametrize(('effect', 'tolerance'), [
    (('friction', 'motor', {'coulomb': 10.0}), 1e-3),
    (('friction', 'motor', {'coulomb': 10.0, 'stribeck': 5.0, 'stribeck_velocity': 0.1}), 1e-2),
    (('friction', 'motor', {'coulomb': 10.0, 'bristle_stiffness': 1e4}), 4e-3),
    (('dead_zone', 'spool', {'width': 3e-6}), 1e-3),
    (('dead_zone', 'command', {'width': 0.03}), 1e-3),
    (('backlash', 'coupling', {'gap': 1e-3}), 1e-3),
    (('saturation', 'spool', {'lower': -1e-5, 'upper': 2e-5}), 1e-3),
    (('rate_limit', 'spool', {'limit': 5e-4}), 1e-3),
    (('hysteresis', 'spool', {'width': 3e-6}), 1e-3),
    (('hysteresis', 'command', {'width': 0.03, 'slope': 0.5}), 1e-3),
    (('delay', 'command', {'time': 0.006}), 1e-3),
    (('lag', 'command', {'time_constant': 0.008}), 1e-3),
    (('lag', 'sensor', {'time_constant': 0.008}), 1e-3),
    (('mode', 'command', {'natural_frequency': 30.0, 'damping_ratio': 0.2}), 1e-3),
    (('mode', 'sensor', {'natural_frequency': 30.0, 'damping_ratio': 0.2}), 1e-3),
    (('asymmetry', 'flow', {'imbalance': 0.2}), 1e-3),
    (('bias', 'motor', {'offset': 5.0}), 1e-3),
    (('orifice', 'flow', {'supply_pressure': 12e6}), 1e-3),
    (('leakage', 'leakage', {'flow': 1e-6, 'exponent': 0.5}), 1e-3),
    (('stiffening', 'coupling', {'cubic': 3e3}), 1e-3),
    (('ripple', 'motor', {'cosine': 3.0, 'sine': 2.0, 'periods': 9.0}), 1e-3),
], ids=lambda value: f'{value[0]}@{value[1]}-{len(value[2])}' if isinstance(value, tuple) else '')
def test_the_predictors_kernel_agrees_within_its_tolerance(effect, tolerance):
    """RMS, as a share of the output's; of four sub-steps in 2 ms.

    Most of it is theta_d, which the kernel knows only at the samples.
    """
    series = rig([effect], 1.5)
    placed = place(*effect, RIG)
    model = Model(RIG, {**VECTOR, 'D_m': D_M}, T, (placed,))
    error = Analytical(model).free_run(series) - series['T_g']
    linear = rig((), 1.5)['T_g'] - series['T_g']
    size = np.sqrt(np.mean(series['T_g'] ** 2))
    assert np.sqrt(np.mean(error ** 2)) < tolerance * size
    assert np.sqrt(np.mean(linear ** 2)) > 3 * tolerance * size       # the effect shows


AXIS = PLANTS['positioning']
AXIS_VALUES = {'M': 10.0, 'F_v': 5.0}


def axis(force, friction, duration):
    placed = [place('friction', 'motor', friction, AXIS)]
    return simulate(AXIS, AXIS_VALUES, placed, {'force': force}, duration)['x']


def test_friction_holds_below_and_slides_above_its_force():
    x = axis(lambda t: np.where(t < 0.5, 7.9, -7.9), {'coulomb': 8.0}, 1.0)
    assert np.abs(x).max() < 1e-18
    x = axis(lambda t: np.full_like(t, 12.0), {'coulomb': 8.0}, 1.0)
    t = 0.001 * np.arange(1000)
    tau = 10.0 / 5.0                            # M v' = 12 - 8 - F_v v, from rest
    expected = (12.0 - 8.0) / 5.0 * (t - tau * -np.expm1(-t / tau))
    np.testing.assert_allclose(x, expected, atol=1e-4 * expected[-1])


def test_friction_stops_a_moving_mass_where_energy_says():
    x = axis(lambda t: np.where(t < 0.3, 12.0, 0.0), {'coulomb': 8.0}, 1.5)
    tau, push = 2.0, 0.3
    v_0 = 4.0 / 5.0 * -np.expm1(-push / tau)
    x_0 = 4.0 / 5.0 * (push - tau * -np.expm1(-push / tau))
    stop = tau * np.log1p(5.0 * v_0 / 8.0)
    expected = x_0 + tau * v_0 - 8.0 / 5.0 * stop
    assert x[-1] == pytest.approx(expected, rel=2e-3)
    assert np.ptp(x[-500:]) == 0.0


def test_breakaway_takes_the_extra_force():
    friction = {'coulomb': 8.0, 'stribeck': 3.0, 'stribeck_velocity': 0.01}
    x = axis(lambda t: 20.0 * t, friction, 1.0)
    assert np.argmax(x > 1e-12) == pytest.approx(550, abs=2)      # at 11 N, not at 8


def test_bristles_bend_elastically_below_the_sliding_force():
    friction = {'coulomb': 8.0, 'bristle_stiffness': 1e4}

    def force(t):
        return 4.0 * -np.expm1(-t / 0.2)

    t = 0.001 * np.arange(800)
    found = axis(force, friction, 0.8)
    x = np.zeros(2)
    expected = [0.0]
    for k in range(799):                        # the force is held over a sample
        x = solve_ivp(lambda _, x, f: [(f - 5.0 * x[0] - 1e4 * x[1]) / 10.0, x[0]], (0, 0.001), x,
                      args=(float(force(t[k])),), rtol=1e-9, atol=1e-13).y[:, -1]
        expected.append(x[1])
    # The implicit bristle damps its own ringing a little: first order in the step.
    np.testing.assert_allclose(found, expected, atol=5e-3 * max(expected))


@pytest.mark.parametrize('name', PLANTS)
def test_every_plant_can_be_simulated_and_replayed(name):
    plant = PLANTS[name]
    values = {p.name: math.sqrt(p.lower * p.upper) for p in plant.parameters}
    T = plant.sample_time
    inputs = {s.name: lambda t: 0.1 * np.sin(2 * np.pi * 0.006 / T * t) for s in plant.inputs}
    series = simulate(plant, values | plant.constant_values(), (), inputs, 200 * T)
    model = Model(plant, values | plant.constant_values(), plant.sample_time)
    size = np.abs(series[plant.output.name]).max()
    error = Analytical(model).free_run(series) - series[plant.output.name]
    # Held inputs leave nothing to chance; what moves between the samples does.
    held = all(signal.held for signal in plant.inputs)
    assert np.abs(error).max() < (1e-7 if held else 2e-3) * size


def test_a_drift_and_a_run_without_a_sample_are_refused():
    drift = [('drift', 'beta_e', {'rate': 0.01, 'begin': 1000.0, 'end': 1003.0})]
    with pytest.raises(UserError, match='a drift cannot be simulated'):
        rig(drift)
    with pytest.raises(UserError, match='shorter than a sample'):
        rig(duration=0.4 * T)
