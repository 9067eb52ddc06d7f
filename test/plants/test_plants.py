from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from hydro_twin.errors import ModelError, UserError
from hydro_twin.fitting.unknowns import plant_unknowns
from hydro_twin.plants import plant_named, PLANTS

TYPICAL = {name: {p.name: (p.lower * p.upper) ** 0.5 for p in plant.parameters}
           | plant.constant_values() for name, plant in PLANTS.items()}


def load_simulator(v, x, u, d):
    """Write out the five laws, each port's value with what an effect adds to it."""
    x_v, p_L, omega, theta = x
    u_m, theta_d = u
    command = u_m + d[0]                                            # eq. 15
    rate = (v['K_sv'] * command - x_v) / v['K_p'] + d[1]
    opening = x_v + d[2]
    pressure = p_L + d[3]
    flow = v['K_q'] * opening + d[4]                                # eq. 11
    leakage = v['K_ce'] * pressure + d[5]
    p_rate = (flow - leakage - v['D_m'] * omega) * 4 * v['beta_e'] / v['V_m']   # eq. 12
    force = v['D_m'] * pressure - v['B_m'] * omega + d[6]
    torque = v['G'] * (theta - theta_d) + d[7]                      # eq. 14
    acceleration = (force - torque) / v['J']                        # eq. 13
    ports = [command, rate, opening, pressure, flow, leakage, force, torque, torque + d[8]]
    signals = [p_L, opening, pressure, pressure, omega, theta, theta - theta_d]
    return [rate, p_rate, acceleration, omega], ports, signals


def valve_servo(v, x, u, d):
    c, a, y = x
    command = u[0] + d[0]
    error = command - y + d[1]
    pilot = c + d[2]
    speed = pilot / v['T_c'] + d[3]
    linkage = a + d[4]
    stem = y + d[5]
    return ([(v['k_1'] * error - c) / v['T_y'], speed, (linkage - y) / v['tau']],
            [command, error, pilot, speed, linkage, stem, stem + d[6]], [c, a])


def cylinder(v, x, u, d):
    q, position = x
    command = u[0] + d[0]
    rate = (command - q) / v['tau'] + d[1]
    opening = q + d[2]
    speed = v['K_v'] * opening + d[3]
    return [rate, speed], [command, rate, opening, speed, position + d[4]], [opening, position]


def positioning(v, x, u, d):
    velocity, position = x
    command = u[0] + d[0]
    force = command - v['F_v'] * velocity + d[1]
    return [force / v['M'], velocity], [command, force, position + d[2]], [velocity, position]


def rotary_axis(v, x, u, d):
    omega, theta = x
    command = u[0] + d[0]
    torque = command - v['B'] * omega + d[1]
    return [torque / v['J'], omega], [command, torque, theta + d[2]], [omega, theta]


def drive(v, x, u, d):
    omega = x[0]
    command = u[0] + d[0]
    torque = command - v['B'] * omega + d[1]
    return [torque / v['J']], [command, torque, omega + d[2]], [omega]


def control_valve(v, x, u, d):
    y = x[0]
    command = u[0] + d[0]
    force = v['K'] * command - y + d[1]
    speed = force / v['tau'] + d[2]
    stem = y + d[3]
    return [speed], [command, force, speed, stem, stem + d[4]], [y]


@pytest.mark.parametrize('by_hand', [load_simulator, valve_servo, cylinder, positioning,
                                     rotary_axis, drive, control_valve])
def test_matrices_are_the_laws_with_what_effects_add(by_hand):
    plant, v = PLANTS[by_hand.__name__], TYPICAL[by_hand.__name__]
    laws = plant.laws(v)
    rng = np.random.default_rng(0)
    size = 1.0 / np.maximum(np.abs(laws.A).max(axis=0), 1.0)
    for _ in range(5):
        x = size * rng.standard_normal(len(laws.A))
        u = rng.standard_normal(laws.B.shape[1])
        d = rng.standard_normal(len(plant.ports)) * 1e-3
        rates, ports, signals = by_hand(v, x, u, d)
        np.testing.assert_allclose(laws.A @ x + laws.B @ u + laws.E @ d, rates, rtol=1e-9)
        np.testing.assert_allclose(laws.port_x @ x + laws.port_u @ u + laws.port_d @ d + d, ports,
                                   rtol=1e-9)
        np.testing.assert_allclose(
            laws.signal_x @ x + laws.signal_u @ u + laws.signal_d @ d, signals, rtol=1e-9)


@pytest.mark.parametrize(('name', 'reads'), [
    ('load_simulator', lambda v, x, d: [x[1] + d[3], x[0], x[3], x[2]]),
    ('valve_servo', lambda v, x, d: [x[1]]),
    ('cylinder', lambda v, x, d: [v['K_v'] * (x[0] + d[2]) + d[3]]),
    ('positioning', lambda v, x, d: [x[0]]),
    ('control_valve', lambda v, x, d: []),
])
def test_sensors_read_what_they_are_named_for(name, reads):
    plant, v = PLANTS[name], TYPICAL[name]
    laws = plant.laws(v)
    rng = np.random.default_rng(1)
    x, u, d = (rng.standard_normal(k) for k in (plant.order, len(plant.inputs), len(plant.ports)))
    np.testing.assert_allclose(laws.sensor_x @ x + laws.sensor_u @ u + laws.sensor_d @ d,
                               reads(v, x, d), rtol=1e-12)


def test_equations_that_do_not_give_the_declared_sensors_are_refused():
    plant = PLANTS['positioning']
    with pytest.raises(ModelError, match=r'sensors v; declared are $'):
        replace(plant, sensors=()).laws(TYPICAL['positioning'])


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_ports_depend_only_on_those_before(plant):
    laws = plant.laws(TYPICAL[plant.name])
    assert not np.triu(laws.port_d).any()
    assert laws.signal_x.shape[0] == sum(len(port.signals) for port in plant.ports)
    assert len(plant.at_rest) == plant.order - 1


@pytest.mark.parametrize(('name', 'numerator', 'denominator'), [
    ('valve_servo', lambda v: [v['k_1']],
     lambda v: [v['T_c'] * v['T_y'] * v['tau'], v['T_c'] * (v['T_y'] + v['tau']), v['T_c'],
                v['k_1']]),
    ('cylinder', lambda v: [v['K_v']], lambda v: [v['tau'], 1.0, 0.0]),
    ('positioning', lambda v: [1.0], lambda v: [v['M'], v['F_v'], 0.0]),
    ('control_valve', lambda v: [v['K']], lambda v: [v['tau'], 1.0]),
])
def test_transfer_function(name, numerator, denominator):
    v = TYPICAL[name]
    laws = PLANTS[name].laws(v)
    num, den = signal.ss2tf(laws.A, laws.B, laws.C, laws.D)
    wanted_num, wanted_den = np.array(numerator(v)), np.array(denominator(v))
    np.testing.assert_allclose(den, wanted_den / wanted_den[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(num[0, -1], wanted_num[0] / wanted_den[0], rtol=1e-9)


def test_a_set_of_parameters_that_is_not_the_plants_is_refused():
    plant = PLANTS['cylinder']
    with pytest.raises(ModelError, match='no parameter J'):
        plant.check({'tau': 0.1, 'K_v': 0.1, 'J': 1.0})
    with pytest.raises(ModelError, match='K_v of cylinder is missing'):
        plant.check({'tau': 0.1})
    with pytest.raises(ModelError, match='outside its physical range'):
        plant.check({'tau': -0.1, 'K_v': 0.1})
    with pytest.raises(ModelError, match='outside its physical range'):
        plant.check({'tau': float('nan'), 'K_v': 0.1})


@pytest.mark.parametrize('ports', [
    lambda ports: ports[1:], lambda ports: (*ports, ports[-1]), lambda ports: ports[::-1],
    lambda ports: (ports[0], replace(ports[1], signals={}), ports[2]),
    lambda ports: (ports[0], replace(ports[1], signals={
        f'{name} of it': unit for name, unit in ports[1].signals.items()}), ports[2])])
def test_equations_that_do_not_fit_the_declared_ports_are_refused(ports):
    plant = PLANTS['positioning']
    with pytest.raises(ModelError, match='declared'):
        replace(plant, ports=ports(plant.ports)).laws(TYPICAL['positioning'])


def test_equations_that_do_not_give_every_rate_are_refused():
    plant = PLANTS['positioning']
    with pytest.raises(ModelError, match='rates'):
        replace(plant, states=('v', 'x', 'y')).laws(TYPICAL['positioning'])


def test_constants_are_checked():
    plant = PLANTS['load_simulator']
    assert plant.constant_values({'D_m': 3e-5}) == {'D_m': 3e-5}
    with pytest.raises(ModelError, match='no constant Q'):
        plant.constant_values({'Q': 1.0})
    with pytest.raises(ModelError, match='positive'):
        plant.constant_values({'D_m': 0.0})


def test_a_held_parameter_is_a_constant_and_frees_what_acted_with_it():
    plant = PLANTS['valve_servo']
    held = plant.holding({'k_1': 1.5})
    assert [p.name for p in held.parameters] == ['T_y', 'T_c', 'tau']
    assert held.combinations == ()
    values = {'T_y': 0.02, 'T_c': 0.3, 'tau': 0.003}
    np.testing.assert_array_equal(held.laws(values | held.constant_values()).A,
                                  plant.laws(values | {'k_1': 1.5}).A)
    assert plant.holding({}).parameters == plant.parameters


@pytest.mark.parametrize(('known', 'says'), [
    ({'D_m': 1.0}, 'no parameter D_m; it has T_y, T_c, tau, k_1'),
    ({'k_1': -1.0}, 'outside its physical range'),
    ({'k_1': float('nan')}, 'outside its physical range'),
    ({'T_y': 0.02, 'T_c': 0.3, 'tau': 0.003, 'k_1': 1.0}, 'none is left to fit'),
])
def test_what_cannot_be_held_is_refused(known, says):
    with pytest.raises(ModelError, match=says):
        PLANTS['valve_servo'].holding(known)


def test_a_parameter_given_as_a_constant_is_told_how_to_hold_it():
    with pytest.raises(ModelError, match=r'no constant k_1.*--fix k_1=1.093 holds'):
        PLANTS['valve_servo'].constant_values({'k_1': 1.093})


def test_an_unknown_plant_is_refused_with_those_there_are():
    with pytest.raises(UserError, match=', '.join(sorted(PLANTS))):
        plant_named('servo')


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_only_commands_move_the_commanded_states(plant):
    """Each by a stable lag."""
    laws = plant.laws(TYPICAL[plant.name])
    for name in plant.commanded:
        i = plant.states.index(name)
        assert laws.A[i, i] < 0.0
        assert not np.delete(laws.A[i], i).any()
        assert all(signal.held for signal, gain in zip(plant.inputs, laws.B[i], strict=True)
                   if gain)


def test_a_plant_of_one_integrator_integrates():
    def equations(p, x, u, port):
        speed = p.K_v * port('command', u.command)
        port('sensor', x.x)
        return {'x': speed}

    cylinder = PLANTS['cylinder']
    plant = replace(
        cylinder, equations=equations, states=('x',), sensors=(), at_rest=(),
        parameters=tuple(p for p in cylinder.parameters if p.name == 'K_v'),
        ports=tuple(p for p in cylinder.ports if p.name in ('command', 'sensor')))
    assert plant.integrates


def test_a_lag_that_no_sample_shows_is_not_fitted():
    valve = PLANTS['control_valve']
    for sample_time, least in ((1.0, 0.1), (0.02, 3e-3)):
        tau = next(u for u in plant_unknowns(valve, 'physical', sample_time) if u.name == 'tau')
        assert tau.lower == pytest.approx(least)
