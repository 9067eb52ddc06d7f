"""The observer against a textbook filter, a simulated truth, and what a rig must not send."""
from dataclasses import replace
import math

from loaded_cylinder import moved
import numpy as np
import pytest
from scipy.linalg import cholesky, expm
from scipy.signal import cont2discrete

from hydro_twin.errors import ModelError
from hydro_twin.fitting.noise import estimate_noise, excerpts, MAX_SAMPLES
from hydro_twin.model import Model, Noise, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors import kernel
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.observer import Observation, Observer, process_root
from hydro_twin.recording.series import Series
from hydro_twin.simulation.simulate import simulate

LOAD = PLANTS['load_simulator']
RIGS = {
    'linear': [],
    'friction': [('friction', 'motor', {'coulomb': 10.0})],
    'dead_zone': [('dead_zone', 'spool', {'width': 3e-6})],
    'backlash': [('backlash', 'coupling', {'gap': 1e-3})],
    'both': [('friction', 'motor', {'coulomb': 10.0}), ('dead_zone', 'spool', {'width': 3e-6})],
}
NOISE = Noise(0.5, {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1},
              {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01})


def values_of(plant):
    return plant.constant_values() | plant.middle()


def model_of(plant, effects=(), noise=None):
    return Model(plant, values_of(plant), plant.sample_time,
                 tuple(place(*effect, plant) for effect in effects), noise=noise)


def covariance_of_noise(A, intensity, T):
    """Integrate e^As diag(q^2) e^A's over a sample [Van Loan 1978]."""
    n = len(A)
    block = np.block([[-A, np.diag(intensity ** 2)], [np.zeros((n, n)), A.T]])
    exponential = expm(block * T)
    return exponential[n:, n:].T @ exponential[:n, n:]


@pytest.mark.parametrize(('lengths', 'taken'), [
    ([6000, 10], [MAX_SAMPLES]), ([50, 200, 1, 7], [200, 50, 7]),
    ([900] * 10, [MAX_SAMPLES // 8] * 8)])
def test_noise_is_estimated_from_as_much_of_the_longest_series_as_it_takes(lengths, taken):
    series = [Series({'x': np.arange(n, dtype=float)}, 0.01) for n in lengths]
    assert [len(one) for one in excerpts(series)] == taken


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_the_linear_observer_is_the_textbooks_kalman_filter(plant):
    rng = np.random.default_rng(4)
    laws, T, n = plant.laws(values_of(plant)), plant.sample_time, plant.order
    spread = {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01}
    start = np.array([spread.get(name, 0.3) for name in plant.states])
    driven = laws.E.any(axis=1)
    intensity = np.where(driven, 0.5 * start, 0.0)
    r = float(np.linalg.norm(laws.C @ np.diag(start))) * 0.3
    noise = Noise(r, dict(zip(plant.states, intensity, strict=True)),
                  dict(zip(plant.states, start, strict=True)))
    inputs = 0.2 * start[0] * np.cumsum(rng.standard_normal((300, len(plant.inputs))), axis=0)
    for j, signal in enumerate(plant.inputs):
        if not signal.held:
            inputs[:, j] = 0.1                  # of which every interpolation is the same
    measured = 5.0 * r * rng.standard_normal(300)
    measured[100:130] = np.nan

    unit = np.diag(start)                       # scipy warns of states whose units differ much
    A, B = np.linalg.solve(unit, laws.A @ unit), np.linalg.solve(unit, laws.B)
    C, D = laws.C @ unit, laws.D
    Phi, Gamma, *_ = cont2discrete((A, B, C, D), T, 'zoh')
    Q = covariance_of_noise(A, intensity / start, T)
    observer = Observer(Analytical(model_of(plant)).system, noise)
    x, P = observer.system.start(inputs[0], measured[0]) / start, np.eye(n)
    expected = []
    for k in range(300):
        if k > 0:
            x, P = Phi @ x + Gamma @ inputs[k - 1], Phi @ P @ Phi.T + Q
        variance = float((C @ P @ C.T)[0, 0]) + r * r
        y = float((C @ x + D @ inputs[k])[0])
        expected.append([y, variance])
        if math.isfinite(measured[k]):
            K = P @ C[0] / variance
            x = x + K * (measured[k] - y)
            keep = np.eye(n) - np.outer(K, C[0])
            P = keep @ P @ keep.T + r * r * np.outer(K, K)      # Joseph
    found, states = observer.run(inputs, measured, estimates=True)
    scale = np.abs(np.array(expected)).max(axis=0)
    np.testing.assert_allclose(found / scale, np.array(expected) / scale, atol=1e-8)
    np.testing.assert_allclose(states[-1] / start, [x, np.sqrt(np.diag(P))], atol=1e-7)


def test_ahead_the_linear_observer_goes_on_by_the_matrices():
    """From the states and standard deviations that an observer without correlations holds."""
    laws, T = LOAD.laws(values_of(LOAD)), LOAD.sample_time
    model = model_of(LOAD, noise=NOISE)
    stepper = Analytical(model).stepper('observer')
    stepper.step(np.array([0.3, 0.1]), math.nan)       # nothing is measured: the start as given
    start = np.array([NOISE.start[name] for name in LOAD.states])
    x = Analytical(model).system.start(np.array([0.3, 0.1]), 0.0)
    intensity = np.array([NOISE.process.get(name, 0.0) for name in LOAD.states])
    unit = np.diag(start)
    A, B = np.linalg.solve(unit, laws.A @ unit), np.linalg.solve(unit, laws.B)
    Phi, Gamma, C, D, _ = cont2discrete((A, B, laws.C @ unit, laws.D), T, 'zoh')
    Q, x, P = covariance_of_noise(A, intensity / start, T), x / start, np.eye(len(start))
    for samples in range(1, 301):
        x, P = Phi @ x + Gamma @ [0.3, 0.1], Phi @ P @ Phi.T + Q
        if samples in (1, 7, 300):
            variance = float((C @ P @ C.T)[0, 0]) + NOISE.measurement ** 2
            expected = float((C @ x + D @ [0.3, 0.1])[0]), math.sqrt(variance)
            assert stepper.ahead(samples) == pytest.approx(expected, rel=1e-7)


def test_ahead_is_a_run_of_held_inputs_in_which_nothing_is_measured():
    """With memory, a delay, and more samples than a live run keeps."""
    effects = (('backlash', 'coupling', {'gap': 1e-3}), ('delay', 'command', {'time': 0.0051}))
    model = model_of(LOAD, effects, NOISE)
    rng = np.random.default_rng(5)
    inputs = 0.02 * np.cumsum(rng.standard_normal((900, 2)), axis=0)
    measured = 5.0 * rng.standard_normal(900)
    stepper = Analytical(model).stepper('observer')
    for k in range(800):
        before = stepper.step(inputs[k], measured[k])
    inputs[800:], measured[800:] = inputs[799], math.nan
    found, _ = Analytical(model).filter.run(inputs, measured)
    assert before == found[799, 0]
    for samples in (1, 40, 100):
        y, deviation = stepper.ahead(samples)
        assert (y, deviation ** 2) == pytest.approx(tuple(found[799 + samples]), rel=1e-12)


def test_noise_over_a_long_time_is_the_stationary_covariance():
    """Of one state that decays, q^2 tau / 2, though e^(T / tau) overflows."""
    laws = PLANTS['valve_servo'].laws(values_of(PLANTS['valve_servo']))
    one = replace(laws, A=np.array([[-500.0]]))
    assert process_root(one, 10.0, np.array([3.0]))[0, 0] ** 2 == pytest.approx(9.0 / 1000.0)


def excited(rng, amplitude=0.3):
    """Make a command and a motion of the shaft that begin at rest."""
    f, phase = rng.uniform(0.5, 9.0, 5), rng.uniform(0.0, 2.0 * np.pi, 5)

    def gate(t):
        return -np.expm1(-(t / 0.1) ** 2)

    def command(t):
        t = np.floor(t / 0.002 + 1e-6) * 0.002
        return amplitude * gate(t) * np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1)

    return command, lambda t: 0.02 * gate(t) * np.sin(2 * np.pi * 1.3 * t)


def watching(state):
    """Make a load simulator whose sensor shows one of its states."""
    def equations(p, x, u, port):
        class Through:
            sensor = port.sensor

            def __call__(self, name, value, **signals):
                return port(name, getattr(x, state) if name == 'sensor' else value, **signals)

        return LOAD.equations(p, x, u, Through())
    return replace(LOAD, equations=equations)


@pytest.mark.slow
@pytest.mark.parametrize('rig', RIGS)
def test_the_bands_hold_the_truth_of_states_that_are_not_measured(rig):
    """Of the independent integrator, under noise on the command that nobody records."""
    rng = np.random.default_rng(7)
    loud, quiet, duration = 0.3, 0.3, 16.0
    command, shaft = excited(rng)
    unknown = loud * rng.standard_normal(round(duration / 0.002) + 1)

    def disturbed(t):
        return command(t) + unknown[np.floor(np.asarray(t) / 0.002 + 1e-6).astype(int)]

    placed = [place(*effect, LOAD) for effect in RIGS[rig]]
    inputs = {'u_m': disturbed, 'theta_d': shaft}
    values = values_of(LOAD)
    truth = {state: simulate(watching(state), values, placed, inputs, duration)['T_g']
             for state in ('x_v', 'p_L', 'omega_j')}
    series = simulate(LOAD, values, placed, inputs, duration)
    measured = series['T_g'] + quiet * rng.standard_normal(len(series))
    start = dict.fromkeys(LOAD.states, 0.0) | {
        'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 1e-2, 'theta_j': 1e-4}
    rate = values['K_sv'] / values['K_p'] * loud * math.sqrt(0.002)
    predictor = Analytical(model_of(LOAD, RIGS[rig], Noise(quiet, {'x_v': rate}, start)))
    recorded = np.column_stack([command(0.002 * np.arange(len(series))),
                                series['theta_d']])
    _, states = predictor.filter.run(recorded, measured, estimates=True)
    held = {}
    for state, true in truth.items():
        estimate, deviation = states[250:, :, LOAD.states.index(state)].T
        held[state] = float(np.mean(np.abs(true[250:] - estimate) < 1.96 * deviation))
    assert all(0.93 <= share <= 0.97 for share in held.values()), held


def test_what_effects_keep_is_shown_by_name_and_holds_the_truth():
    """The torque of dry friction, and where in the gap of the coupling the shaft is."""
    effects = (*RIGS['friction'], *RIGS['backlash'])
    rng = np.random.default_rng(3)
    command, shaft = excited(rng)
    t = 0.002 * np.arange(3000)
    model = model_of(LOAD, effects, NOISE)
    system, inputs = model.system, np.column_stack([command(t), shaft(t)])
    x, z, work = np.zeros(4), np.zeros(system.memory), system.work()
    truth, y = np.empty((3000, 2)), np.empty(3000)
    for k in range(3000):
        kernel.run(system.step, x, z, work, inputs, y, np.empty((0, 0)), k, k + 1)
        truth[k] = (x[3] - inputs[k, 1]) / 1e-3, -z[-2]     # added to the motor, before coupling
    observer = Analytical(model).filter
    assert observer.names == (*LOAD.states, 'motor_friction_force', 'coupling_backlash_side')
    _, estimates = observer.run(inputs, y + 0.5 * rng.standard_normal(3000), estimates=True)
    side, force = (estimates[500:, :, k] for k in (5, 4))
    assert np.mean(np.abs(side[:, 0] - truth[500:, 0]) < 2.5 * side[:, 1]) > 0.9
    assert np.sqrt(np.mean((force[:, 0] - truth[500:, 1]) ** 2)) < 2.0      # of 10 N m
    assert np.abs(truth[500:, 1]).max() == pytest.approx(10.0)


def test_the_load_pressure_of_a_cylinder_is_seen_through_its_position():
    """The force on its mass, by other, smaller steps of the same law."""
    cylinder = PLANTS['cylinder']
    rng = np.random.default_rng(4)
    t = 0.002 * np.arange(3000)
    command = 2.0 * np.sin(9.0 * t) * np.sin(2.5 * t)
    values = {'tau': 0.02, 'K_v': 0.15}
    load = {'full_load_speed': 0.8, 'imbalance': 0.0, 'inertia': 0.1, 'compliance': 0.003}
    position, truth = moved(command, 0.002, **values, load=load)
    model = Model(cylinder, values, 0.002, (place('orifice', 'piston', load, cylinder),),
                  noise=Noise(1e-4, {'q': 0.1}, {'q': 0.1, 'x': 1e-3}))
    observer = Analytical(model).filter
    assert observer.names == ('q', 'x', 'piston_orifice_load_pressure')
    _, estimates = observer.run(command[:, None], position + 1e-4 * rng.standard_normal(3000),
                                estimates=True)
    assert np.abs(truth).max() > 0.3
    assert np.sqrt(np.mean((estimates[:, 0, 2] - truth) ** 2)) < 0.02


@pytest.mark.parametrize('rig', RIGS)
def test_where_the_model_is_right_only_the_noise_is_left(rig):
    rng = np.random.default_rng(2)
    command, shaft = excited(rng)
    series = simulate(LOAD, values_of(LOAD), [place(*effect, LOAD) for effect in RIGS[rig]],
                      {'u_m': command, 'theta_d': shaft}, 3.0)
    noise = 0.6 * rng.standard_normal(len(series))
    series.columns['T_g'][:] += noise
    model = model_of(LOAD, RIGS[rig])
    model = replace(model, noise=estimate_noise(model, [series.part(0, 1000)]))
    assert model.noise.measurement == pytest.approx(0.6, rel=0.06)
    held_out = slice(1000, None)
    missed = {mode: np.sqrt(np.mean((series['T_g'] - getattr(Analytical(model), mode)(series))[
        held_out] ** 2)) for mode in ('one_step', 'observer', 'free_run')}
    floor = np.sqrt(np.mean(noise[held_out] ** 2))
    assert missed['observer'] < 1.02 * floor
    assert missed['observer'] < min(missed['one_step'], 1.01 * missed['free_run'])


def noisy(seed):
    """Return a recording of the linear plant with noise of 0.6 N m."""
    rng = np.random.default_rng(seed)
    command, shaft = excited(rng)
    series = simulate(LOAD, values_of(LOAD), [], {'u_m': command, 'theta_d': shaft}, 3.0)
    series.columns['T_g'][:] += 0.6 * rng.standard_normal(len(series))
    return series


def loss(series, noise):
    """Return minus the logarithm of the likelihood of the torque."""
    predictor = Analytical(replace(model_of(LOAD), noise=noise))
    observed, _ = Observer(predictor.system, noise).run(
        predictor.inputs(series), series['T_g'][:, None])
    left, variance = series['T_g'][1:] - observed[1:, 0], observed[1:, 1]
    return 0.5 * np.sum(np.log(variance) + left ** 2 / variance)


@pytest.mark.parametrize('seed', range(3))
def test_no_noise_of_the_process_is_found_where_none_explains_the_measurement_better(seed):
    series = noisy(seed)
    found = estimate_noise(model_of(LOAD), [series])
    without = min(loss(series, replace(
        found, measurement=share * found.measurement,
        process={state: 1e-3 * value for state, value in found.process.items()}))
        for share in (0.98, 1.0, 1.02))
    assert loss(series, found) < without + 0.1


@pytest.mark.parametrize('seed', range(3))
def test_no_other_size_of_all_noise_is_likelier(seed):
    series = noisy(seed)
    found = estimate_noise(model_of(LOAD), [series])
    for share in (0.95, 1.05):
        assert loss(series, found) < loss(series, replace(
            found, measurement=share * found.measurement,
            process={state: share * value for state, value in found.process.items()}))


def test_where_the_model_is_wrong_it_beats_both_other_modes():
    rng = np.random.default_rng(2)
    command, shaft = excited(rng)
    series = simulate(LOAD, values_of(LOAD), [place(*RIGS['friction'][0], LOAD)],
                      {'u_m': command, 'theta_d': shaft}, 3.0)
    series.columns['T_g'][:] += 0.6 * rng.standard_normal(len(series))
    model = model_of(LOAD)
    model = replace(model, noise=estimate_noise(model, [series.part(0, 1000)]))
    missed = {mode: np.sqrt(np.mean((series['T_g'] - getattr(Analytical(model), mode)(series))[
        1000:] ** 2)) for mode in ('one_step', 'observer', 'free_run')}
    assert missed['observer'] < 0.7 * min(missed['one_step'], missed['free_run'])


@pytest.mark.parametrize('rig', RIGS)
@pytest.mark.parametrize('what', ['constant', 'steps', 'mostly missing', 'wild'])
def test_the_covariance_stays_positive_definite_and_all_is_finite(rig, what):
    rng = np.random.default_rng(3)
    measured = {'constant': np.full(3000, 40.0),
                'steps': 500.0 * np.sign(np.sin(np.arange(3000) / 50.0)),
                'mostly missing': np.where(rng.random(3000) < 0.02, 10.0, np.nan),
                'wild': 1e5 * rng.standard_normal(3000)}[what]
    inputs = np.cumsum(rng.standard_normal((3000, 2)), axis=0) * [0.02, 1e-4]
    observer = Analytical(model_of(LOAD, RIGS[rig], NOISE)).filter
    system = observer.system
    x = system.start(inputs[0], float(np.nan_to_num(measured[0])))
    observation = Observation(observer, x, np.zeros(system.memory))
    results, none = np.empty((3000, 2)), np.empty((0, 2, len(observer.names)))
    for begin in range(0, 3000, 50):
        observation.advance(0, inputs, measured[:, None], begin, begin + 50, results, none)
        S = observation.scratch.S
        P = (S @ S.T)[:len(x), :len(x)]
        scale = np.sqrt(np.diag(P))
        cholesky(P / np.outer(scale, scale))            # raises if it is not definite
    assert np.isfinite(results).all()
    assert (results[:, 1] >= NOISE.measurement ** 2).all()


def test_a_covariance_that_grows_while_nothing_is_measured_begins_anew():
    """A run that gains energy, as one with negative damping does, is not followed for ever."""
    plant = PLANTS['positioning']
    model = model_of(plant, noise=Noise(1e-3, {'v': 1e3}, {'v': 1.0, 'x': 1.0}))
    measured = np.full(200_000, np.nan)
    results, _ = Analytical(model).filter.run(np.zeros((200_000, 1)), measured)
    assert np.isfinite(results).all()
    assert results[:, 1].max() <= (1e3 * plant.output_scale) ** 2 * (1 + 1e-9) + 1e-6
    assert results[-1, 1] < results[:, 1].max()


def test_a_model_without_noise_has_no_observer():
    with pytest.raises(ModelError, match='no section `observer`'):
        Analytical(model_of(LOAD)).stepper('observer')
    with pytest.raises(ModelError, match='mode observer: this model has one_step, free_run'):
        model_of(LOAD).run(Series({'u_m': np.zeros(9)}, 0.002), 'observer')


def test_a_run_that_diverges_has_no_noise():
    series = Series({'force': np.full(500, 1e300), 'x': np.zeros(500)}, 0.001)
    assert estimate_noise(model_of(PLANTS['positioning']), [series]) is None
