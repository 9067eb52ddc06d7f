"""Where a fault enters: against a filter by hand, an exact likelihood, and simulated rigs."""
from __future__ import annotations

from dataclasses import replace
import json
import math
import sys
import threading
import time

from live_rig import SIGNALS
import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.stats import multivariate_normal

from hydro_twin.live.diagnostics import Diagnosis
from hydro_twin.live.inputs import TwinInputs
from hydro_twin.live.locate import change, integrated, locate
from hydro_twin.live.location import Location
from hydro_twin.live.locator import EARLY, HELD_BACK, KEPT, LEAD, LEAST, Locator, SPAN, YIELD
from hydro_twin.live.monitor import LEARN, Rise
from hydro_twin.live.signatures import curve, KNOTS, LAGS, lags, LOOPS, loops
from hydro_twin.live.twin import Twin
from hydro_twin.live.unknown_input import Suspect, with_unknown_input
from hydro_twin.model import Model, Noise, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.observer import process_root
from hydro_twin.simulation.simulate import simulate

LOAD = PLANTS['load_simulator']
T = LOAD.sample_time
VALUES = LOAD.constant_values() | LOAD.middle()
NOISE = Noise(0.5, {'x_v': 1e-8, 'p_L': 1e3, 'omega_j': 1e-2},
              {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1, 'theta_j': 1e-3})
FRICTION = ('friction', 'motor', {'coulomb': 2.0})
MODEL = Model(LOAD, VALUES, T, noise=NOISE).with_record(
    errors={'after': {'observer': {'test': 0.51}}})


def moved(effects: list[tuple[str, str, dict[str, float]]], duration: float, seed: int
          ) -> tuple[np.ndarray, np.ndarray]:
    """Simulate a rig by the integrator that shares nothing with the kernel, with noise.

    It begins and ends at rest, so that others can follow.
    """
    rng = np.random.default_rng(seed)

    def gate(t: np.ndarray) -> np.ndarray:
        share = np.clip(np.minimum(t, duration - 0.3 - t) / 0.1, 0.0, 1.0)
        return share ** 2 * (3.0 - 2.0 * share)

    def command(t: np.ndarray) -> np.ndarray:
        t = np.floor(t / T + 1e-6) * T
        return 0.1 * gate(t) * sum(np.sin(2 * np.pi * f * t + f) for f in (0.7, 1.9, 4.3))

    series = simulate(LOAD, VALUES, [place(*effect, LOAD) for effect in effects],
                      {'u_m': command, 'theta_d': lambda t: 0.01 * gate(t) * np.sin(9.0 * t)},
                      duration)
    return (np.column_stack([series['u_m'], series['theta_d']]),
            series['T_g'] + 0.5 * rng.standard_normal(len(series)))


def joined(sound: float, faulty: float) -> tuple[np.ndarray, np.ndarray]:
    """Simulate a rig that is sound for so many seconds, and then rubs."""
    before, after = moved([], sound, 6), moved([FRICTION], faulty, 7)
    return np.vstack([before[0], after[0]]), np.concatenate([before[1], after[1]])


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_an_unknown_input_enters_as_what_an_effect_adds(plant) -> None:
    """Of every port but the last, whose value is the output; there the output moves by it."""
    values = plant.constant_values() | plant.middle()
    laws = plant.laws(values)
    for index in range(len(plant.ports)):
        found = with_unknown_input(plant, index, 2.0).laws(values)
        np.testing.assert_allclose(found.A[:-1, -1], 2.0 * laws.E[:, index])
        np.testing.assert_allclose(found.B[:-1, -1], 2.0 * laws.E[:, index])
        assert not found.A[-1].any()
        output = 1.0 if index == len(plant.ports) - 1 else laws.port_d[-1, index]
        assert found.C[0, -1] == pytest.approx(2.0 * output)


def test_an_unknown_input_at_the_command_is_held_as_that_is() -> None:
    """There it does what as much more of the command does; a measured angle is interpolated."""
    inputs, _ = moved([], 0.8, 1)
    given = np.random.default_rng(5).standard_normal(len(inputs))
    index = [port.name for port in LOAD.ports].index('command')
    augmented = replace(MODEL, plant=with_unknown_input(LOAD, index, 0.1)).system
    np.testing.assert_allclose(
        augmented.run(np.column_stack([inputs, given]), np.zeros(LOAD.order + 1)),
        MODEL.system.run(inputs + 0.1 * np.outer(given, [1.0, 0.0]), np.zeros(LOAD.order)),
        atol=1e-9)


def test_responses_are_what_the_observer_does_with_an_input_and_without() -> None:
    inputs, measured = moved([], 0.8, 1)
    measured[200] = math.nan
    index = [port.name for port in LOAD.ports].index('motor')
    root = process_root(LOAD.laws(VALUES), T, np.array([
        NOISE.process.get(name, 0.0) for name in LOAD.states]))
    suspect = Suspect(MODEL, index, 0.2, inputs, measured, 100,
                      MODEL.system.start(inputs[0], 0.0), root)
    given = np.random.default_rng(4).standard_normal((2, len(inputs) - 100))
    plain = suspect.run(3.0)
    found = suspect.responses(plain, given)
    for row, expected in zip(found, given, strict=True):
        with_it = suspect.run(3.0, expected).innovation
        np.testing.assert_allclose(np.where(np.isnan(with_it[100:]), math.nan, row),
                                   (plain.innovation - with_it)[100:], atol=1e-9)


def test_the_walk_is_the_textbooks_augmented_kalman_filter() -> None:
    """At the motor: innovations and likelihood by matrices that are made here."""
    index = [port.name for port in LOAD.ports].index('motor')
    inputs, measured = moved([], 0.8, 1)
    inputs[:, 1] = 0.0                          # of which every interpolation is the same
    start = MODEL.system.start(inputs[0], 0.0)
    laws, walk, unit = LOAD.laws(VALUES), 3.0, 0.2
    root = process_root(laws, T, np.array([NOISE.process.get(name, 0.0) for name in LOAD.states]))
    seen = Suspect(MODEL, index, unit, inputs, measured, 0, start, root).run(walk)
    n = LOAD.order
    A = np.zeros((n + 3, n + 3))
    A[:n] = np.hstack([laws.A, unit * laws.E[:, [index]], laws.B])
    step = expm(A * T)
    Phi, Gamma = step[:n + 1, :n + 1], step[:n + 1, n + 1:]
    Q = block_diag(root @ root.T, walk ** 2 * T)
    P = block_diag(np.diag([NOISE.start[name] for name in LOAD.states]) ** 2, 0.0)
    x, C = np.append(start, 0.0), np.append(laws.C[0], unit * laws.port_d[-1, index])
    expected = []
    for k, y in enumerate(measured):
        if k:
            x, P = Phi @ x + Gamma @ inputs[k - 1], Phi @ P @ Phi.T + Q
        variance = C @ P @ C + NOISE.measurement ** 2
        innovation = y - C @ x - laws.D[0] @ inputs[k]
        gain = P @ C / variance
        x, P = x + gain * innovation, P - np.outer(gain, C @ P)
        expected.append((innovation, variance))
    e, v = np.array(expected).T
    np.testing.assert_allclose(seen.innovation, e / np.sqrt(v), atol=1e-6)
    assert seen.log_likelihood(50) == pytest.approx(-0.5 * np.sum((np.log(v) + e * e / v)[50:]))


def test_integrated_coefficients_are_the_likelihood_of_correlated_noise() -> None:
    """Against the density of a normal vector with that covariance, at some spreads."""
    rng = np.random.default_rng(2)
    S = rng.standard_normal((4, 40)) * [[1.0], [3.0], [3.0], [3.0]]
    e = rng.standard_normal(40) + 2.0 * S[2]
    gain, mean = integrated(S, np.append(e, math.nan)[:40])
    white = multivariate_normal(np.zeros(40)).logpdf(e)
    densities = [multivariate_normal(np.zeros(40), np.eye(40) + a * a * np.outer(S[0], S[0])
                                     + b * b * S[1:].T @ S[1:]).logpdf(e) - white
                 for a in np.geomspace(1e-3, 1e3, 60) for b in np.geomspace(1e-3, 1e3, 60)]
    assert max(densities) - 1.0 < gain <= max(densities) + 0.01
    assert mean == pytest.approx([0.0, 0.0, 2.0, 0.0], abs=0.2)


def test_curves_and_loops_are_what_they_are_called() -> None:
    signal = np.linspace(-2.0, 2.0, 401)
    np.testing.assert_allclose(curve(signal).sum(axis=0), KNOTS * (signal + 2.0) / 4.0)
    back = loops(np.concatenate([signal, signal[::-1]]))
    for half, row in zip(LOOPS, back, strict=True):
        assert row[400] == pytest.approx(1.0)               # it slides at its half width
        turned = 401 + round(2.0 * half * 2.0 / 0.01)       # twice that to slide the other way
        assert row[turned - 3] > -1.0
        assert row[turned + 3] == pytest.approx(-1.0)


def test_lags_are_behind_a_step_by_what_is_left_of_an_exponential() -> None:
    signal = np.repeat([0.0, 1.0], [10, 90])
    k = np.arange(1, 91)
    for lag, row in zip(LAGS, lags(signal), strict=True):
        np.testing.assert_allclose(row[:10], 0.0, atol=1e-12)
        np.testing.assert_allclose(row[10:], -2.0 * np.exp(-k / lag), atol=1e-12)


def test_the_change_of_a_variance_is_found() -> None:
    rng = np.random.default_rng(3)
    innovation = rng.standard_normal(2000)
    innovation[700:] *= 4.0
    assert abs(change(innovation, 300, 1000) - 700) < 5


@pytest.mark.slow
@pytest.mark.parametrize('effect', [
    FRICTION,
    ('stiffening', 'coupling', {'cubic': 3e3}),
    ('leakage', 'leakage', {'flow': 4e-6, 'exponent': 0.5}),
    ('lag', 'sensor', {'time_constant': 0.005}),
], ids=lambda effect: effect[1])
def test_the_port_of_an_effect_of_another_integrator_is_named(effect) -> None:
    inputs, measured = moved([effect], 4.0, 4)
    where = locate(MODEL, inputs, measured, 0, 0)
    assert effect[1] in where.ports, where
    assert len(where.ports) <= 2, where


@pytest.mark.slow
def test_what_the_model_explains_is_not_located() -> None:
    inputs, measured = moved([], 4.0, 5)
    measured[1000:1100] = math.nan
    where = locate(MODEL, inputs, measured, 0, 0)
    assert where.ports == ()
    assert str(where) == 'is not located'


def test_a_rise_waits_for_the_samples_of_the_fault_or_for_their_end(monkeypatch) -> None:
    asked = []

    def located(model, inputs, measured, first, last) -> Location:
        asked.append((len(inputs), measured[first], measured[last]))
        return Location(('motor',))

    monkeypatch.setattr('hydro_twin.live.locate.locate', located)
    locator, rise = Locator(MODEL), Rise(2000, 2500, 2500, 1.0, 0.5)     # a sample a nanosecond
    assert locator.located() is None
    locator.take(rise)
    for k in range(2500 + SPAN + 1):
        if k in (3000, 4000):
            assert locator.located() is None        # too few of the fault, and more came
            assert not locator.at_work
        locator.add(k, np.zeros(2), float(k))
    while (found := locator.located()) is None:
        time.sleep(0.001)
    assert found == replace(rise, location=Location(('motor',)))
    assert asked == [(LEAD + EARLY + 500 + SPAN + 1, 2000 - EARLY, 2500)]
    assert locator.located() is None                # once

    locator.clear()
    locator.take(rise)
    for k in range(2500 + LEAST - 1):
        locator.add(k, np.zeros(2), float(k))
    assert locator.located() is None                # the first time, more may come
    while (found := locator.located()) is None:
        time.sleep(0.001)
    assert found.location == Location()             # of so few samples
    assert len(asked) == 1


def test_of_a_slow_plant_the_event_is_not_held_back_for_the_samples() -> None:
    """At 1 Hz they would take three quarters of an hour."""
    second = 10 ** 9
    locator = Locator(MODEL)
    locator.take(Rise(2000 * second, 2010 * second, 2010 * second, 1.0, 0.5))
    waited = 0
    for k in range(2000 + SPAN):
        locator.add(k * second, np.zeros(2), float(k))
        if k < 2010:
            continue
        waited = k - 2010
        if locator.located() is not None or locator.at_work:
            break
    assert 1 <= waited <= HELD_BACK
    while (found := locator.located()) is None and locator.at_work:
        time.sleep(0.001)
    assert found is None or found.location == Location()


def test_of_a_fault_older_than_the_samples_the_last_are_taken(monkeypatch) -> None:
    asked = []
    monkeypatch.setattr('hydro_twin.live.locate.locate',
                        lambda *args: asked.append(args) or Location())
    locator = Locator(MODEL)
    for k in range(2 * KEPT):
        locator.add(k, np.zeros(2), float(k))
    locator.take(Rise(100, 600, 2 * KEPT - 1, 1.0, 0.5))
    while locator.located() is None:
        time.sleep(0.001)
    (_, inputs, measured, first, last), = asked
    assert (len(inputs), measured[-1], first, last) == (SPAN, 2 * KEPT - 1, 0, 0)


def test_threads_take_turns_as_before_once_the_last_location_is_found(monkeypatch) -> None:
    usual = sys.getswitchinterval()
    go_on = [threading.Event(), threading.Event()]
    waiting = iter(go_on)
    lock = threading.Lock()

    def slow(*_) -> Location:
        with lock:
            mine = next(waiting)
        assert mine.wait(10.0)
        return Location()

    monkeypatch.setattr('hydro_twin.live.locate.locate', slow)
    locators = [Locator(MODEL), Locator(MODEL)]
    for locator in locators:
        for k in range(SPAN + LEAST):
            locator.add(k, np.zeros(2), float(k))
        locator.take(Rise(0, 0, 0, 1.0, 0.5))
        locator.located()
        assert locator.at_work
    for event, during in zip(go_on, (YIELD, usual), strict=True):
        assert sys.getswitchinterval() == pytest.approx(YIELD)
        event.set()
        left = sum(not one.is_set() for one in go_on)
        while sum(locator._thread.is_alive() for locator in locators) > left:
            time.sleep(0.001)
        assert sys.getswitchinterval() == pytest.approx(during)


def test_a_reset_while_the_residual_is_judged_leaves_what_begins_alone(monkeypatch) -> None:
    """The node resets in one thread and judges in another."""
    twin = Twin('', Analytical(MODEL), 'observer')
    monitor, found = twin.monitor, Rise(0, 0, 0, 1.0, 0.5)

    def judge() -> Rise:
        twin.start_over()
        return found

    before = twin._locator
    monkeypatch.setattr(monitor, 'judge', judge)
    monkeypatch.setattr(before, 'located', lambda: None)     # what it takes on stays there
    assert twin.judge() is None
    assert before is not twin._locator
    assert before._rise is found
    assert twin._locator._rise is None


@pytest.mark.slow
def test_event_and_diagnostics_carry_where_the_fault_enters(monkeypatch) -> None:
    """A sound rig, then one that rubs, through the live twin as the node steps and judges it."""
    announcer = pytest.importorskip('hydro_twin.ros.announcer')
    inputs, measured = joined(34.0, 9.0)
    twin = Twin('', Analytical(MODEL), 'observer')
    rise = None
    for k, (row, value) in enumerate(zip(inputs, measured.tolist(), strict=True)):
        twin.step(k * 2_000_000, row, value)
        if k % 500 == 0:
            rise = twin.judge() or rise
    while rise is None:
        time.sleep(0.01)
        rise = twin.judge()
    assert rise.end > LEARN * 2_000_000
    assert twin.monitor is not None
    assert twin.monitor.rise == rise
    published: list[str] = []
    node = object.__new__(announcer.Announcer)
    monkeypatch.setattr(node, '_event', type('Publisher', (), {
        'publish': lambda _, message: published.append(message.data)})(), raising=False)
    node.refit(twin, rise, ['/command'])
    event = json.loads(published[0])
    assert event['event'] == 'refit'
    assert set(event) == {'event', 'model', 'topics', 'begin', 'settled', 'end', 'rms',
                          'reference_rms', 'sign', 'location'}
    assert event['reference_rms'] == 0.51
    assert event['sign'] in ('level', 'colour')
    assert 'motor' in event['location']['ports']
    assert event['location']['gain'] > 100.0
    assert event['location']['says'].startswith('enters at motor')
    statuses = Diagnosis(TwinInputs(LOAD, SIGNALS, T, 0.1), [twin]).statuses(0, 1.0, {})
    assert 'the fault enters at motor' in statuses[-1].message
    assert statuses[-1].values['location'].startswith('motor')
