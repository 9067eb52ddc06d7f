"""The observer fed by several sensors: against a textbook filter, and when they fail."""
from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete

from hydro_twin.fitting.noise import estimate_noise
from hydro_twin.model import Model, Noise, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.observer import Observer
from hydro_twin.recording.series import Series
from hydro_twin.simulation.simulate import simulate

LOAD = PLANTS['load_simulator']
SENSED = {name: plant for name, plant in PLANTS.items() if plant.sensors}
START = {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01}
NOISE = Noise(0.5, {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1}, START,
              sensors={'p_L': 3e4, 'x_v': 1.5e-7, 'omega_m': 5e-3})


def values_of(plant):
    return plant.constant_values() | plant.middle()


def model_of(plant, effects=(), noise=None):
    return Model(plant, values_of(plant), plant.sample_time,
                 tuple(place(*effect, plant) for effect in effects), noise=noise)


@pytest.mark.parametrize('plant', SENSED.values(), ids=SENSED)
def test_one_sensor_after_another_is_the_textbooks_update_with_all(plant):
    """A Kalman filter that inverts the covariance of the whole innovation, sample by sample."""
    rng = np.random.default_rng(4)
    laws, T, n, N = plant.laws(values_of(plant)), plant.sample_time, plant.order, 400
    start = np.array([START.get(name, 0.3) for name in plant.states])
    unit = np.diag(start)
    A, B = np.linalg.solve(unit, laws.A @ unit), np.linalg.solve(unit, laws.B)
    C, D = np.vstack([laws.C, laws.sensor_x]) @ unit, np.vstack([laws.D, laws.sensor_u])
    intensity = np.where(laws.E.any(axis=1), 0.5, 0.0)
    block = np.block([[-A, np.diag(intensity ** 2)], [np.zeros((n, n)), A.T]]) * T
    exponential = expm(block)
    Phi, Gamma, *_ = cont2discrete((A, B, C, D), T, 'zoh')
    Q = exponential[n:, n:].T @ exponential[:n, n:]
    root = np.linalg.cholesky(Q + 1e-18 * np.eye(n))
    r = 0.3 * np.linalg.norm(C, axis=1)
    inputs = 0.2 * start[0] * np.cumsum(rng.standard_normal((N, len(plant.inputs))), axis=0)
    for j, signal in enumerate(plant.inputs):
        if not signal.held:
            inputs[:, j] = 0.1                  # of which every interpolation is the same
    system = Analytical(model_of(plant)).system
    true, measured = np.empty((N, n)), np.empty((N, len(C)))
    true[0] = system.start(inputs[0], 0.0) / start + rng.standard_normal(n)
    for k in range(N):
        if k > 0:
            true[k] = Phi @ true[k - 1] + Gamma @ inputs[k - 1] + root @ rng.standard_normal(n)
        measured[k] = C @ true[k] + D @ inputs[k] + r * rng.standard_normal(len(C))
    measured[100:130, 0] = np.nan
    for o in range(1, len(C)):                  # at a rate of its own, and then it fails
        measured[np.arange(N) % (o + 1) > 0, o] = np.nan
        measured[N - 50 * o:, o] = np.nan

    sensors = [sensor.name for sensor in plant.sensors]
    observer = Observer(system, Noise(
        r[0], dict(zip(plant.states, intensity * start, strict=True)),
        dict(zip(plant.states, start, strict=True)),
        sensors=dict(zip(sensors, r[1:], strict=True))))
    x, P = system.start(inputs[0], measured[0, 0]) / start, np.eye(n)
    expected, likelihood = [], 0.0
    for k in range(N):
        if k > 0:
            x, P = Phi @ x + Gamma @ inputs[k - 1], Phi @ P @ Phi.T + Q
        there = np.isfinite(measured[k])
        H, R = C[there], np.diag(r[there] ** 2)
        e = measured[k, there] - H @ x - D[there] @ inputs[k]
        expected.append([C[0] @ x + D[0] @ inputs[k], C[0] @ P @ C[0] + r[0] ** 2])
        S = H @ P @ H.T + R
        likelihood -= 0.5 * (np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e))
        K = np.linalg.solve(S, H @ P).T
        keep = np.eye(n) - K @ H
        x, P = x + K @ e, keep @ P @ keep.T + K @ R @ K.T          # Joseph
    found, states = observer.run(inputs, measured, estimates=True)
    scale = np.abs(np.array(expected)).max(axis=0)
    np.testing.assert_allclose(found[:, :2] / scale, np.array(expected) / scale, atol=1e-8)
    np.testing.assert_allclose(states[-1] / start, [x, np.sqrt(np.diag(P))], atol=1e-7)
    innovation, variance = measured - found[:, ::2], found[:, 1::2]
    assert -0.5 * np.nansum(np.log(variance) * np.isfinite(measured) + innovation ** 2 / variance
                            ) == pytest.approx(likelihood, rel=1e-9)


def excited(rng):
    """Make a command and a motion of the shaft that begin at rest."""
    f, phase = rng.uniform(0.5, 9.0, 5), rng.uniform(0.0, 2.0 * np.pi, 5)

    def gate(t):
        return -np.expm1(-(t / 0.1) ** 2)

    def command(t):
        t = np.floor(t / 0.002 + 1e-6) * 0.002
        return 0.3 * gate(t) * np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1)

    return command, lambda t: 0.02 * gate(t) * np.sin(2 * np.pi * 1.3 * t)


EVERY = {'p_L': 5, 'x_v': 2, 'omega_m': 1}         # samples of the torque to one of the sensor
FRICTION = ('friction', 'motor', {'coulomb': 10.0})
LOUD = 0.3              # noise on the command that nobody records [V]


def rig(effects=(), duration=16.0, seed=7):
    """Simulate a rig with three sensors: what was recorded, and the truth without noise."""
    rng = np.random.default_rng(seed)
    command, shaft = excited(rng)
    unknown = LOUD * rng.standard_normal(round(duration / 0.002) + 1)

    def disturbed(t):
        return command(t) + unknown[np.floor(np.asarray(t) / 0.002 + 1e-6).astype(int)]

    names = [sensor.name for sensor in LOAD.sensors]
    true = simulate(LOAD, values_of(LOAD), [place(*effect, LOAD) for effect in effects],
                    {'u_m': disturbed, 'theta_d': shaft}, duration, sensors=names)
    N = len(true)
    columns = {'u_m': command(0.002 * np.arange(N)), 'theta_d': true['theta_d'],
               'T_g': true['T_g'] + NOISE.measurement * rng.standard_normal(N)}
    for name, every in EVERY.items():
        columns[name] = np.where(np.arange(N) % every == 0, true[name], np.nan) + (
            NOISE.sensors[name] * rng.standard_normal(N))
    return Series(columns, 0.002), true


def predictor(effects=(), sensors=NOISE.sensors):
    """Make an observer of that rig that knows its noise, of these sensors."""
    values = values_of(LOAD)
    rate = values['K_sv'] / values['K_p'] * LOUD * math.sqrt(0.002)
    start = dict.fromkeys(LOAD.states, 0.0) | {
        'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 1e-2, 'theta_j': 1e-4}
    return Analytical(model_of(LOAD, effects, Noise(
        NOISE.measurement, {'x_v': rate}, start, sensors=sensors)))


TRUTH = {'x_v': 'x_v', 'p_L': 'p_L', 'omega_j': 'omega_m', 'theta_j': 'theta_m'}


def shares(series, true, estimates, where):
    """Say how often the 95 % band of each state holds the truth."""
    return {state: float(np.mean(np.abs(true[name][where] - value) < 1.96 * deviation))
            for state, name in TRUTH.items()
            for value, deviation in [estimates[where, :, LOAD.states.index(state)].T]}


def errors(true, estimates, where):
    """Return the RMS errors of the states."""
    return {state: float(np.sqrt(np.mean(
        (true[name] - estimates[:, 0, LOAD.states.index(state)])[where] ** 2)))
        for state, name in TRUTH.items()}


@pytest.mark.slow
@pytest.mark.parametrize('effects', [(), (FRICTION,)], ids=['linear', 'friction'])
def test_the_bands_hold_the_truth_and_grow_where_a_sensor_fails(effects):
    series, true = rig(effects, 32.0)
    half = len(series) // 2
    series.columns['x_v'][half:] = np.nan
    _, estimates = predictor(effects).observed(series)
    _, alone = predictor(effects, {}).observed(series)
    assert np.isfinite(estimates).all()
    parts = slice(250, half), slice(half + 250, None)
    for where in parts:
        held = shares(series, true, estimates, where)
        assert all(0.93 <= share <= 0.97 for share in held.values()), held
    before, after = (np.sqrt(np.mean(estimates[where, 1, :4] ** 2, axis=0)) for where in parts)
    assert after[0] > 1.4 * before[0]           # of the spool, whose sensor failed
    assert (after > before).all()
    assert (after < 0.7 * np.sqrt(np.mean(alone[parts[1], 1, :4] ** 2, axis=0))).all()


@pytest.mark.slow
@pytest.mark.parametrize('sensors', [('p_L',), ('omega_m',), ('p_L', 'omega_m')])
def test_the_likelihood_tells_the_noise_of_each_sensor(sensors):
    """And that of the process, from a rig that noise on the command disturbs."""
    series, true = rig()
    recorded = replace(series, columns={name: series[name] for name in (
        'u_m', 'theta_d', 'T_g', *sensors)})
    model = model_of(LOAD)
    noise = estimate_noise(model, [recorded])
    right = predictor().model.noise
    assert noise.measurement == pytest.approx(right.measurement, rel=0.06)
    assert list(noise.sensors) == [*sensors]
    for name, value in noise.sensors.items():
        assert value == pytest.approx(right.sensors[name], rel=0.2), name
    assert noise.process['x_v'] == pytest.approx(right.process['x_v'], rel=0.15)
    known = Analytical(replace(model, noise=noise))
    missed = (series['T_g'] - known.observer(recorded))[250:]
    assert noise.innovation == pytest.approx(np.sqrt(np.mean(missed ** 2)), rel=0.06)
    held = shares(series, true, known.observed(recorded)[1], slice(250, None))
    assert all(0.9 < share < 0.98 for share in held.values()), held


def test_a_model_that_knows_no_sensor_passes_them_over():
    series, _ = rig(duration=2.0)
    torque = Series({name: series[name] for name in ('u_m', 'theta_d', 'T_g')}, 0.002)
    knows_none, knows_all = predictor(sensors={}), predictor()
    assert (knows_none.observer(series) == knows_none.observer(torque)).all()
    assert (knows_all.observer(torque) == knows_none.observer(torque)).all()
    knows_one = predictor(sensors={'x_v': NOISE.sensors['x_v']})
    only = replace(series, columns={**torque.columns, 'x_v': series['x_v']})
    assert (knows_one.observer(series) == knows_all.observer(only)).all()
    assert (knows_one.observer(series) != knows_none.observer(torque)).any()


@pytest.mark.parametrize('follow', [{}, {'B_m': 0.1}])
def test_live_it_is_the_same_to_the_last_digit(follow):
    series, _ = rig((FRICTION,), 2.0)
    base = predictor((FRICTION,)).model
    model = Analytical(replace(base, noise=replace(base.noise, follow=follow)))
    expected, estimates = model.observed(series)
    stepper = model.stepper('observer')
    missing = np.full(len(series), np.nan)
    rows = np.column_stack([series.columns.get(s.name, missing) for s in LOAD.sensors])
    for k, (u, y, row) in enumerate(zip(model.inputs(series), series['T_g'], rows, strict=True)):
        assert stepper.step(u, y, None, row) == expected[k]
        assert (stepper.estimate == estimates[k, :, :len(model.filter.names)]).all()


@pytest.mark.parametrize('effects', [(), (FRICTION,)], ids=['linear', 'friction'])
@pytest.mark.parametrize('what', ['constant', 'wild', 'right'])
def test_whatever_sensors_read_the_covariance_stays_positive_definite(effects, what):
    rng = np.random.default_rng(3)
    series, _ = rig(effects, 4.0)
    N = len(series)
    model = predictor(effects)
    rows = model.measured(replace(series, columns={**series.columns, **{name: {
        'constant': np.full(N, 1.0), 'right': series[name],
        'wild': 10.0 ** rng.uniform(-12.0, 12.0, N)}[what] for name in EVERY}}))
    stepper = model.stepper('observer')
    for k, inputs in enumerate(model.inputs(series)):
        assert math.isfinite(stepper.step(inputs, rows[k, 0], None, rows[k, 1:]))
        if k % 50 == 49:
            S = stepper.observation.scratch.S[:4]
            scale = np.sqrt(np.square(S).sum(axis=1))
            np.linalg.cholesky(S @ S.T / np.outer(scale, scale))    # raises if it is not definite


@pytest.mark.parametrize('what', ['outliers', 'hangs', 'off', 'wild'])
def test_a_sensor_that_is_wrong_does_not_spoil_the_estimates(what):
    """They stay as good as without it, and when it is right again it is used again."""
    series, true = rig(duration=12.0)
    begin, end = 2000, 4000
    column, rng = series['omega_m'].copy(), np.random.default_rng(1)
    if what == 'outliers':
        hit = begin + np.flatnonzero(rng.random(end - begin) < 0.02)
        column[hit] += rng.choice([-1e6, -3.0, 3.0, 1e6], len(hit))
    else:
        column[begin:end] = {'hangs': np.full(end - begin, column[begin]),
                             'off': column[begin:end] + 0.2,
                             'wild': rng.standard_normal(end - begin)}[what]
    spoilt = replace(series, columns={**series.columns, 'omega_m': column})
    without = replace(series, columns={**series.columns, 'omega_m': np.where(
        (np.arange(len(series)) >= begin) & (np.arange(len(series)) < end), np.nan,
        series['omega_m'])})
    model = predictor()
    (_, good), (_, bad), (_, none) = (model.observed(one) for one in (series, spoilt, without))
    least = good if what == 'outliers' else none
    for state, error in errors(true, bad, slice(begin, end)).items():
        assert error < 1.15 * errors(true, least, slice(begin, end))[state], state
    # Once it is right again for a fifth of a second, as if nothing had been.
    later = slice(end + 100, None)
    for state, error in errors(true, bad, later).items():
        assert error == pytest.approx(errors(true, good, later)[state], rel=1e-3)
