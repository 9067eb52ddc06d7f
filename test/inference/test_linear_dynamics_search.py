"""Linear dynamics that the plant lacks: delay, lag, mode, flexible load, or said to be alike."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim
from traced_rig import fitted, PLANT, record

from benchmarks.tracing.not_quite import CASES, recording
from hydro_twin.inference import stepwise
from hydro_twin.inference.criterion import delta_bic
from hydro_twin.inference.findings import Finding
from hydro_twin.inference.search import search_all
from hydro_twin.inference.select import Alternative, simplest_first
from hydro_twin.inference.trace import trace
from hydro_twin.model import place
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series
from hydro_twin.report.summary import summarise
from hydro_twin.result import AMBIGUOUS_DELTA_BIC, Improvement

DELAY = ('delay', 'command', {'time': 0.004})
LAG = ('lag', 'command', {'time_constant': 0.004})
MODE = ('mode', 'command', {'natural_frequency': 40.0, 'damping_ratio': 0.5})
FRICTION = ('friction', 'motor', {'coulomb': 6.0})


def alternative(*effect):
    placed = place(*effect, PLANT)
    return Alternative(SimpleNamespace(candidate=SimpleNamespace(effects=(placed,))))


@pytest.mark.parametrize(('scores', 'first'), [
    ((0.0, 4.0, 9.0), 'lag'), ((0.0, 4.0, 11.0), 'mode')])
def test_a_mode_is_chosen_only_where_it_is_clearly_better_than_a_lag(scores, first):
    given = [alternative(*effect) for effect in (MODE, DELAY, LAG)]
    ordered = simplest_first(given, scores)
    assert ordered[0].id == first
    assert sorted(c.id for c in ordered) == ['delay', 'lag', 'mode']


def test_a_lag_or_a_friction_that_is_best_stays_first():
    for best in (LAG, FRICTION):
        given = [alternative(*effect) for effect in (best, MODE, DELAY)]
        assert simplest_first(given, (0.0, 1.0, 2.0)) == given


@pytest.mark.parametrize(('rival', 'first'), [
    (DELAY, 'hysteresis'), (('dead_zone', 'command', {'width': 0.1}), 'dead_zone')])
def test_a_delay_is_no_static_law_in_the_place_of_a_hysteresis(monkeypatch, rival, first):
    monkeypatch.setattr(stepwise, 'held_out_gain', lambda *_: Improvement(0.0, -0.1, 0.1))

    def left(error, *effect):
        placed = place(*effect, PLANT)
        return Alternative(SimpleNamespace(
            error=error, candidate=SimpleNamespace(effects=(placed,))))

    given = [left(0.5, 'hysteresis', 'command', {'width': 0.1}), left(0.51, *rival)]
    context = SimpleNamespace(held_out=None, seed=0)
    ordered = stepwise._memoryless_first(given, SimpleNamespace(error=1.0), context)
    assert ordered[0].id == first


def test_linear_dynamics_that_are_alike_are_no_doubt_that_they_are_missing():
    """A lag with a delay near is earned; with a friction near it is not."""
    def nearest(*rivals):
        found = Finding(0, 0.0, 0.5, tuple((place(*r, PLANT), d) for r, d in rivals))
        return stepwise._nearest(found, place(*LAG, PLANT).effect)

    assert nearest((DELAY, 2.0), (MODE, 3.0), (FRICTION, 500.0)) == 500.0
    assert nearest((DELAY, 2.0), (FRICTION, 5.0)) == 5.0


def distance(true, others, noise):
    """Fit the true effect and others; how much worse these are by BIC. The rig's lag is 12 ms."""
    alone, parts, _ = fitted(record(true, noise=noise))
    fits = list(search_all([replace(alone.candidate, effects=(place(*effect, PLANT),))
                            for effect in (true, *others)], parts, 40))
    assert fits[0].error == pytest.approx(noise, rel=0.1)
    right, *wrong = delta_bic(fits)
    return [score - right for score in wrong]


@pytest.mark.slow
@pytest.mark.parametrize(('true', 'others'), [
    (('delay', 'command', {'time': 0.008}), (LAG, MODE)),
    (('lag', 'command', {'time_constant': 0.02}), (DELAY,)),
    (('mode', 'command', {'natural_frequency': 25.0, 'damping_ratio': 0.4}), (LAG, DELAY))],
    ids=['delay', 'lag', 'mode'])
def test_phase_and_gain_tell_them_apart(true, others):
    """Under sinusoids up to 15 Hz."""
    assert min(distance(true, others, 0.1)) > 2 * AMBIGUOUS_DELTA_BIC


@pytest.mark.slow
def test_far_below_the_corner_of_a_lag_it_cannot_be_told_from_a_delay():
    (off,) = distance(LAG, (DELAY,), 0.3)
    assert abs(off) < AMBIGUOUS_DELTA_BIC


def named(name):
    report = summarise(trace(Recording(recording(CASES[name]).series[:2]), None, PLANT))
    assert report['verdict'] == 'effect_found'
    return {(e['id'], e['port']): e['parameters'] for e in report['effects']}


@pytest.mark.slow
def test_a_filter_before_the_card_is_a_lag_of_the_sensor():
    (found,) = named('filter_20').items()
    assert found[0] == ('lag', 'sensor')
    assert found[1]['time_constant']['value'] == pytest.approx(1 / (2 * 3.1416 * 20.0), rel=0.05)


@pytest.mark.slow
def test_beside_a_valve_of_second_order_the_friction_is_named_and_no_delay():
    found = named('valve_80_friction')
    assert found['friction', 'motor']['coulomb']['value'] == pytest.approx(6.0, rel=0.05)
    assert {identifier for identifier, _ in found} <= {'friction', 'lag', 'mode'}
    assert len(found) == 2


@pytest.mark.slow
def test_a_valve_of_second_order_before_an_integrator_is_a_mode():
    """A cylinder, made by scipy: x' = 0.05 q, q'' = w^2 (u - q) - 2 D w q'."""
    rng, time = np.random.default_rng(0), 0.004 * np.arange(6000)
    w, damping = 2.0 * np.pi * 11.0, 0.35
    command = sum(0.9 * np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.0))
                  for f in (0.5, 1.3, 3.1, 6.3, 9.7, 14.9))
    A = np.array([[0.0, 0.05, 0.0], [0.0, 0.0, 1.0], [0.0, -w**2, -2.0 * damping * w]])
    B, C, D = np.array([[0.0], [0.0], [w**2]]), np.eye(1, 3), np.zeros((1, 1))
    position = dlsim(cont2discrete((A, B, C, D), 0.004), command)[1][:, 0]
    measured = position + 3e-4 * rng.standard_normal(len(position))
    report = summarise(trace(Recording((Series(
        {'command': command, 'x': measured}, 0.004, start=0, source='made'),)), None,
        plant_named('cylinder')))
    (found,) = report['effects']
    assert (found['id'], found['certain']) == ('mode', True)
    assert found['parameters']['natural_frequency']['value'] == pytest.approx(11.0, rel=0.02)
    assert found['parameters']['damping_ratio']['value'] == pytest.approx(damping, rel=0.03)


@pytest.mark.slow
def test_a_second_inertia_on_a_spring_is_a_flexible_load():
    """An axis, made by scipy: 2 x'' = u - 3 x' + k e + d e', 1.5 (x + e)'' = -k e - d e'."""
    rng, time = np.random.default_rng(0), 0.004 * np.arange(1500)
    k, d = 1.5 * (2.0 * np.pi * 6.0)**2, 2.0 * 0.03 * 1.5 * 2.0 * np.pi * 6.0
    force = sum(5.0 * np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.0))
                for f in (0.4, 1.1, 2.7, 4.9, 6.1, 8.3, 11.7))
    axis = np.array([0.0, -3.0, k, d]) / 2.0
    A = np.vstack([[0.0, 1.0, 0.0, 0.0], axis, [0.0, 0.0, 0.0, 1.0],
                   np.array([0.0, 0.0, -k, -d]) / 1.5 - axis])
    B, C, D = np.array([[0.0], [0.5], [0.0], [-0.5]]), np.eye(1, 4), np.zeros((1, 1))
    position = dlsim(cont2discrete((A, B, C, D), 0.004), force)[1][:, 0]
    measured = position + 1e-3 * np.std(position) * rng.standard_normal(len(position))
    report = summarise(trace(Recording((Series(
        {'force': force, 'x': measured}, 0.004, start=0, source='made'),)), None,
        plant_named('positioning')))
    (found,) = report['effects']
    assert (found['id'], found['port']) == ('flexible_load', 'motor')
    values = {name: value['value'] for name, value in found['parameters'].items()}
    assert values == pytest.approx(
        {'natural_frequency': 6.0, 'damping_ratio': 0.03, 'stiffness': k, 'swings_at_start': 1.0},
        rel=0.03)
