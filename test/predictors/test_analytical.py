from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.linalg import expm
from scipy.optimize import brentq

from hydro_twin.model import Model, Noise, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.system import assemble, LINEAR
from hydro_twin.recording.series import Series

VECTOR = {'V_m': 1.75e-4, 'J': 5.5e-2, 'K_p': 1.75e-2, 'K_q': 1.35, 'G': 1.1e4, 'K_ce': 5.5e-12,
          'B_m': 55.0, 'K_sv': 1.15e-4, 'beta_e': 7e8}
EFFECTS = {
    'friction': ('motor', {'coulomb': 10.0}),
    'dead_zone': ('spool', {'width': 3e-6}),
    'backlash': ('coupling', {'gap': 1e-3}),
    'saturation': ('spool', {'lower': -1e-5, 'upper': 1e-5}),
    'rate_limit': ('spool', {'limit': 3e-4}),
    'hysteresis': ('command', {'width': 0.02}),
    'delay': ('command', {'time': 0.005}),
    'asymmetry': ('flow', {'imbalance': 0.2}),
    'bias': ('motor', {'offset': 3.0}),
    'orifice': ('flow', {'supply_pressure': 12e6}),
    'leakage': ('leakage', {'flow': 1e-6, 'exponent': 0.5}),
    'stiffening': ('coupling', {'cubic': 3e3}),
    'ripple': ('motor', {'cosine': 3.0, 'sine': 2.0, 'periods': 9.0}),
    'lag': ('sensor', {'time_constant': 0.01}),
    'mode': ('command', {'natural_frequency': 30.0, 'damping_ratio': 0.2}),
}
STRENGTHLESS = {
    'dead_zone': ('spool', {'width': 1e-12}),
    'backlash': ('coupling', {'gap': 1e-12}),
    'saturation': ('spool', {'lower': -1.0, 'upper': 1.0}),
    'rate_limit': ('spool', {'limit': 1e6}),
    'hysteresis': ('command', {'width': 1e-12}),
    'delay': ('command', {'time': 1e-6}),
    'asymmetry': ('flow', {'imbalance': 0.0}),
    'bias': ('motor', {'offset': 0.0}),
    'orifice': ('flow', {'supply_pressure': 1e11}),
    'leakage': ('leakage', {'flow': 1e-15, 'exponent': 0.5}),
    'stiffening': ('coupling', {'cubic': 1e-9}),
    'ripple': ('motor', {'cosine': 0.0, 'sine': 0.0, 'periods': 9.0}),
    'friction': ('motor', {'coulomb': 1e-9}),
    'lag': ('command', {'time_constant': 1e-6}),
    'mode': ('sensor', {'natural_frequency': 1e5, 'damping_ratio': 0.7}),
}


def values_of(plant):
    if plant.name == 'load_simulator':
        return dict(VECTOR)
    return {p.name: (p.lower * p.upper) ** 0.5 for p in plant.parameters}


NOISE = Noise(0.5, {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1},
              {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01})


def predictor(plant, effects=(), substeps=4, noise=None):
    placed = tuple(place(name, port, parameters, plant) for name, (port, parameters) in effects)
    return Analytical(Model(plant, plant.constant_values() | values_of(plant), plant.sample_time,
                            placed, substeps=substeps, noise=noise))


def recording(plant, samples=700, seed=0):
    """Smooth random inputs that begin at rest, and an output of no matter what shape."""
    rng = np.random.default_rng(seed)
    t = plant.sample_time * np.arange(samples)
    smooth = signal.butter(2, 0.01, fs=1.0, output='sos')   # 5 Hz at 500 Hz
    scales = {'u_m': 0.4, 'theta_d': 0.02}
    columns = {s.name: scales.get(s.name, 1.0) * np.tanh(t / (25 * plant.sample_time))
               * signal.sosfilt(smooth, rng.standard_normal(samples)) * 4 for s in plant.inputs}
    columns[plant.output.name] = np.zeros(samples)
    return Series(columns, plant.sample_time)


def exact(plant, series):
    """Solve the linear plant by scipy: held inputs by zoh, the others by foh, added up."""
    laws = plant.laws(values_of(plant) | plant.constant_values())
    # scipy's linear algebra warns of states whose units differ much: bring them to one scale.
    scale = np.diag([1e-5, 1e6, 1.0, 1e-2] if plant.name == 'load_simulator'
                    else np.ones(plant.order))
    A, B = np.linalg.solve(scale, laws.A @ scale), np.linalg.solve(scale, laws.B)
    y = np.zeros(len(series))
    for j, source in enumerate(plant.inputs):
        system = (A, B[:, [j]], laws.C @ scale, laws.D[:, [j]])
        discrete = signal.cont2discrete(system, plant.sample_time, 'zoh' if source.held else 'foh')
        y += signal.dlsim(discrete, series[source.name])[1][:, 0]
    return y


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_free_run_of_the_linear_plant_is_scipys(plant):
    series = recording(plant)
    expected = exact(plant, series)
    found = predictor(plant).free_run(series)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_commands_that_move_in_a_straight_line_are_scipys_too(plant):
    series = recording(plant)
    moving = replace(plant, inputs=tuple(replace(one, held=False) for one in plant.inputs))
    expected = exact(moving, series)
    found = Analytical(replace(predictor(plant).model, interpolation=LINEAR)).free_run(series)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_free_run_starts_at_rest_at_the_measured_output():
    plant = PLANTS['load_simulator']
    series = Series({'u_m': np.zeros(5), 'theta_d': np.full(5, 0.3), 'T_g': np.full(5, 42.0)},
                    plant.sample_time)
    first = predictor(plant).free_run(series)
    assert first[0] == pytest.approx(42.0, abs=1e-9)
    system = predictor(plant).system
    x = system.start(np.array([0.0, 0.3]), 42.0)
    rates = system.laws.A @ x + system.laws.B @ [0.0, 0.3]
    assert rates[[0, 2, 3]] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize('cubic', [1e3, 1e6, 1e9])
def test_a_run_starts_at_rest_also_where_the_shaft_stiffens(cubic):
    plant = PLANTS['load_simulator']
    stiffening = place('stiffening', 'coupling', {'cubic': cubic}, plant)
    system = assemble(plant, VECTOR | plant.constant_values(), [stiffening])
    twist = brentq(lambda x: VECTOR['G'] * x * (1.0 + cubic * x * x) - 42.0, 0.0, 0.1, xtol=1e-15)
    x = system.start(np.array([0.0, 0.3]), 42.0)
    assert x[3] - 0.3 == pytest.approx(twist, rel=1e-6)


def test_one_step_of_the_linear_plant_is_eq_1_on_the_measured_past():
    from hydro_twin.plants.load_simulator_eq1 import coefficients

    plant = PLANTS['load_simulator']
    series = recording(plant)
    rng = np.random.default_rng(1)
    series.columns['T_g'][:] = 50 * np.sin(np.arange(len(series)) / 30) + rng.normal(
        size=len(series))
    values = np.array([[VECTOR[p.name] for p in plant.parameters]])
    c = coefficients(values, {'D_m': 2e-5}, 0.002)[0]
    y, u, th = series['T_g'], series['u_m'], series['theta_d']
    expected = [c @ [*y[k - 4:k][::-1], *u[k - 4:k + 1][::-1], *th[k - 4:k + 1][::-1]]
                for k in range(4, len(series))]
    found = predictor(plant).one_step(series)
    assert np.isnan(found[:4]).all()
    np.testing.assert_allclose(found[4:], expected, rtol=1e-8, atol=1e-7)


@pytest.mark.parametrize('name', EFFECTS)
def test_one_step_is_exact_where_the_model_is(name):
    """With y the model's own free run, y - c is what eq. 1 predicts, up to its warping."""
    plant = PLANTS['load_simulator']
    model = predictor(plant, [(name, EFFECTS[name])])
    series = recording(plant)
    series.columns['T_g'][:] = model.free_run(series)
    linear = predictor(plant)
    linear_series = recording(plant)
    linear_series.columns['T_g'][:] = linear.free_run(linear_series)
    warping = np.nanmax(np.abs(linear.one_step(linear_series) - linear_series['T_g']))
    off = np.nanmax(np.abs(model.one_step(series) - series['T_g']))
    assert off <= 1.01 * warping + 1e-9


@pytest.mark.parametrize('mode', ['one_step', 'free_run', 'observer'])
@pytest.mark.parametrize('names', [(), *((name,) for name in EFFECTS),
                                   ('friction', 'dead_zone', 'delay')], ids='+'.join)
def test_live_is_the_batch_bit_for_bit(names, mode):
    plant = PLANTS['load_simulator']
    model = predictor(plant, [(name, EFFECTS[name]) for name in names], noise=NOISE)
    series = recording(plant)                   # longer than what a live run keeps
    series.columns['T_g'][:] = np.random.default_rng(2).normal(size=len(series))
    series.columns['T_g'][100:140] = np.nan     # a sensor that drops out
    stepper = model.stepper(mode)
    inputs = np.column_stack([series['u_m'], series['theta_d']])
    live = [stepper.step(u, y) for u, y in zip(inputs, series['T_g'], strict=True)]
    np.testing.assert_array_equal(live, getattr(model, mode)(series))


@pytest.mark.parametrize('name', STRENGTHLESS)
def test_without_strength_a_model_is_the_linear_one(name):
    plant = PLANTS['load_simulator']
    series = recording(plant)
    linear = predictor(plant).free_run(series)
    found = predictor(plant, [(name, STRENGTHLESS[name])]).free_run(series)
    tolerance = 1e-3 if name in ('delay', 'lag', 'mode', 'orifice') else 1e-6   # least strengths
    np.testing.assert_allclose(found, linear, atol=tolerance * np.abs(linear).max())


@pytest.mark.parametrize('name', sorted(set(EFFECTS) - {'delay', 'hysteresis'}))
def test_finer_substeps_converge(name):
    """Those two act only on the held command: any step is exact."""
    plant = PLANTS['load_simulator']
    series = recording(plant)
    runs = {n: predictor(plant, [(name, EFFECTS[name])], n).free_run(series)
            for n in (1, 4, 16, 128)}
    error = {n: np.sqrt(np.mean((runs[n] - runs[128]) ** 2)) for n in (1, 4, 16)}
    assert error[4] < 0.7 * error[1] + 1e-9
    assert error[16] < 0.7 * error[4] + 1e-9
    assert error[4] < 0.01 * np.abs(runs[128]).max()


def coast(coulomb, velocity, substeps, samples=2000):
    """Run a mass that slides to rest, M v' = -F_v v - F_c."""
    plant = PLANTS['positioning']
    system = assemble(plant, {'M': 10.0, 'F_v': 5.0},
                      [place('friction', 'motor', {'coulomb': coulomb}, plant)], 0.001, substeps)
    seen = np.empty((samples, len(plant.ports) + 2))
    x = system.run(np.zeros((samples, 1)), np.array([velocity, 0.0]), seen=seen)
    return x, seen[:, -2]


@pytest.mark.parametrize('velocity', [0.5, -0.5, 0.013])
def test_friction_only_takes_energy_and_holds_at_rest(velocity):
    x, v = coast(8.0, velocity, 4)
    assert (np.diff(v ** 2) <= 0.0).all()
    assert v[-1] == pytest.approx(0.0, abs=1e-15)
    still = np.abs(v) < 1e-12
    assert np.ptp(x[still]) < 1e-12             # no creep, no chatter


def test_friction_stops_a_mass_where_it_must():
    x, v = coast(8.0, 0.5, 16)
    stop = 10.0 / 5.0 * np.log1p(5.0 * 0.5 / 8.0)
    distance = 10.0 * 0.5 / 5.0 - 8.0 / 5.0 * stop
    assert np.argmax(np.abs(v) < 1e-12) * 0.001 == pytest.approx(stop, abs=0.002)
    assert x[-1] == pytest.approx(distance, rel=1e-3)


def test_a_run_that_diverges_is_nan_from_there_on():
    plant = PLANTS['load_simulator']
    model = predictor(plant, [('stiffening', ('coupling', {'cubic': 1e12}))], substeps=1)
    series = recording(plant)
    found = model.free_run(series)
    assert np.isfinite(found[0])
    assert np.isnan(found[-1])
    first = np.argmax(np.isnan(found))
    assert np.isnan(found[first:]).all()


@pytest.mark.parametrize('name', [*PLANTS, 'with an effect'])
def test_the_response_to_an_initial_state_is_that_of_the_exponential(name):
    plant = PLANTS.get(name, PLANTS['load_simulator'])
    effects = (place('friction', 'motor', {'coulomb': 1.0}, plant),) if name not in PLANTS else ()
    middle = {p.name: float(np.sqrt(p.lower * p.upper)) for p in plant.parameters}
    system = Model(plant, plant.constant_values() | middle, plant.sample_time, effects).system
    response = system.free_response(50)
    for k in (0, 1, 7, 49):
        expected = system.laws.C[0] @ expm(system.laws.A * k * plant.sample_time)
        assert response[k] == pytest.approx(expected, rel=1e-8, abs=1e-12 * abs(expected).max())
