"""A parameter that drifts: its law, the run with it, and what a trace makes of one."""
from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.linalg import expm

from hydro_twin.effects import Span
from hydro_twin.effects.drift import distinguishable, factor, slopes
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import initial_states
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import effect_unknowns, get, plant_unknowns
from hydro_twin.inference import starts
from hydro_twin.inference.trace import trace
from hydro_twin.model import Model, Noise, place, read_model, write_model
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.sensitivities import run_with_sensitivities
from hydro_twin.predictors.system import assemble, STAGES
from hydro_twin.predictors.tangents import tangents_of
from hydro_twin.recording.series import Recording, Series
from hydro_twin.report.summary import sentence

LOAD = PLANTS['load_simulator']
VALUES = LOAD.constant_values() | LOAD.middle()
T = LOAD.sample_time
BEGIN, END = 100.0, 106.0       # stamps [s]
STRAIGHT = {'rate': 0.1, 'begin': BEGIN, 'end': END}
ALL = STRAIGHT | {'idle': 1.0, 'time_constant': 1.5}
JUMP = STRAIGHT | {'idle': 1.0, 'time_constant': 0.02}
INF = math.inf


@pytest.mark.parametrize(('law', 'time', 'expected'), [
    ((0.1, 0.0, INF, BEGIN, END), 90.0, 0.4),           # before: as at the begin
    ((0.1, 0.0, INF, BEGIN, END), 103.0, 0.7),
    ((0.1, 0.0, INF, BEGIN, END), 200.0, 1.0),          # after: as at the end
    ((-0.5, 0.0, INF, BEGIN, END), 101.0, 3.5),
    ((0.1, 2.0, INF, BEGIN, END), 101.9, 0.6),          # it has not begun
    ((0.1, 2.0, INF, BEGIN, END), 104.0, 0.8),
    ((0.1, 9.0, INF, BEGIN, END), 101.0, 1.0),          # it never begins
    ((0.1, 0.0, 2.0, BEGIN, END), 102.0,
     1.0 - 0.6 * (math.exp(-1.0) - math.exp(-3.0)) / (1.0 - math.exp(-3.0))),
    ((0.1, 0.0, 1e7, BEGIN, END), 103.0, 0.7),          # a slow lag is a straight line
    ((0.1, 0.0, 1e20, BEGIN, END), 103.0, 0.7),         # however slow
    ((10.0, 0.0, INF, BEGIN, END), 100.0, 0.2),         # it does not change its sign
    ((-10.0, 0.0, INF, BEGIN, END), 100.0, 5.0),
])
def test_law(law, time, expected):
    assert factor(law, np.array(time)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(('rate', 'drifts'), [
    (0.1, True), (-0.5, True), (0.2, False), (-1.0, False)])
def test_what_changes_more_than_fivefold_is_no_drift(rate, drifts):
    nowhere = Span(((0.0, 0.0),), {}, (0.0, 1.0), T, 0)
    assert distinguishable(nowhere, (rate, 0.0, INF, BEGIN, END)) is drifts


@pytest.mark.parametrize('change', [1e6, -1e6, 1e-3])
@pytest.mark.parametrize('jump', [None, 2.0])
def test_a_search_begins_at_no_change_that_is_beyond_the_law(monkeypatch, change, jump):
    """A parameter that the recording hardly determines may seem to drift by any amount."""
    monkeypatch.setattr(starts, 'drift_test', lambda *_: (1.0, 0.0))
    monkeypatch.setattr(starts, 'drifts', lambda *_: dict.fromkeys(LOAD.middle(), (change, jump)))
    model, first = Model(LOAD, VALUES, T), BEGIN + 0.5
    begun = starts.drift_starts(
        Fit(model, (), np.zeros(9), np.zeros((9, 0)), (9,), 0.0),
        [Part(np.zeros((9, 2)), np.zeros(9), start=round(1e9 * first))], (BEGIN, END))
    assert 'K_ce' in {placed.port.name for one in begun for placed in one.effects}
    for one in begun:
        (placed,) = one.effects
        assert math.copysign(1.0, placed.named['rate']) == math.copysign(1.0, change)
        changed = 1.0 - factor(placed.values, np.array([BEGIN, first + 1.9, END]))
        assert abs(changed[0]) <= min(0.95, abs(change)) + 1e-12
        assert abs(changed[0]) > 0.5 * min(0.8, abs(change))
        assert changed[2] == 0.0
        assert (changed[1] == changed[0]) == (jump is not None)


def test_slopes():
    law = (0.1, 2.0, INF, BEGIN, END)
    np.testing.assert_allclose(slopes(law, np.array([101.0, 105.0])).T, [
        (-4.0, 0.1, 0.0, 0.0, 0.0), (-1.0, 0.0, 0.0, 0.0, 0.0)], atol=1e-9)
    lag = (0.1, 0.0, 2.0, BEGIN, END)
    h = 1e-4
    at = np.array(102.0)
    rise = (factor((0.1, 0.0, 2.0 + h, BEGIN, END), at) - factor(lag, at)) / h
    assert slopes(lag, at)[2] == pytest.approx(rise, rel=1e-3)


def inputs_of(samples):
    t = T * np.arange(samples)
    return np.column_stack([0.3 * np.sin(9.0 * t), 0.02 * np.sin(4.0 * t)])


def exact_run(inputs, drift):
    """Run laws that vary, x' = A(t) x + B(t) u, by scipy's exponential.

    Of the laws in the middle of each sample, in which they hardly change.
    """
    def laws(t):
        return LOAD.laws(VALUES | {'K_ce': VALUES['K_ce'] * factor(drift.values, BEGIN + t)})

    n, x, y = LOAD.order, np.zeros(LOAD.order), [0.0]
    for k in range(1, len(inputs)):
        middle = laws((k - 0.5) * T)
        # The command is held; the angle goes in a straight line, the last of these states.
        whole = np.zeros((n + 3, n + 3))
        whole[:n, :n + 2], whole[n + 1, n + 2] = np.hstack([middle.A, middle.B]), 1.0
        slope = (inputs[k, 1] - inputs[k - 1, 1]) / T
        x = (expm(T * whole) @ [*x, *inputs[k - 1], slope])[:n]
        y.append(float((laws(k * T).C @ x + laws(k * T).D @ inputs[k])[0]))
    return np.array(y)


@pytest.mark.parametrize('parameters', [STRAIGHT, ALL, JUMP])
def test_a_run_is_that_of_laws_that_vary(parameters):
    """To half a stage of the change, which is 0.6 here; of a jump, 64 are a millisecond each."""
    samples = round((END - BEGIN) / T)
    inputs = inputs_of(samples)
    drift = place('drift', 'K_ce', parameters, LOAD)
    system = assemble(LOAD, VALUES, (drift,))
    found = system.run(inputs, np.zeros(LOAD.order), start=round(1e9 * BEGIN))
    y = exact_run(inputs[:1001], drift)
    changed = assemble(LOAD, VALUES).run(inputs, np.zeros(LOAD.order))[:1001]
    effect = np.max(np.abs(changed - y))
    assert np.max(np.abs(found[:1001] - y)) < effect / STAGES
    assert effect > 0.05 * np.max(np.abs(y))


def candidate_of(parameters):
    return Model(LOAD, VALUES, T, (place('drift', 'K_ce', parameters, LOAD),), substeps=2)


@pytest.mark.parametrize('begin', [BEGIN + 1.0, END + 20.0])
def test_the_start_of_a_part_during_a_drift_or_after_it(begin):
    """With an effect, whose states are searched by derivatives of the laws that hold then."""
    friction = place('friction', 'motor', {'coulomb': 5.0}, LOAD)
    drifting = Model(LOAD, VALUES, T, (friction, place('drift', 'J', STRAIGHT, LOAD)), substeps=2)
    inputs, stamp = inputs_of(600), round(1e9 * begin)
    measured = drifting.system.run(inputs, np.full(LOAD.order, 1e-3), start=stamp)
    part = Part(inputs, measured, start=stamp)
    stage = drifting.system.at(stamp)
    alone = initial_states(replace(drifting, values=stage.values, effects=(friction,)), [part])
    np.testing.assert_allclose(initial_states(drifting, [part]).x, alone.x, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize('parameters', [STRAIGHT, ALL])
def test_derivatives_of_a_run(parameters):
    """By differences; theirs are interpolated over a parameter that more than doubles.

    Where the stages move with the unknown, of exact runs, and to 2 % RMS: in the stage in which it
    begins to drift they differ by more.
    """
    candidate = candidate_of(parameters)
    part = Part(inputs_of(3000), np.zeros(3000), start=round(1e9 * BEGIN))
    unknowns = plant_unknowns(LOAD, 'physical') + effect_unknowns(0, candidate.effects[0])
    assert {u.name for u in unknowns if u.owner == '0'} == set(parameters) - {'begin', 'end'}
    problem = Problem(candidate, unknowns, [part])
    by, order = problem.directions(candidate)
    tangents = tangents_of(candidate.system, by)
    x = np.zeros(LOAD.order)
    y, found = (some[:, 0] for some in run_with_sensitivities(
        candidate.system, by, tangents, part.inputs, np.array([0, len(part.inputs)]), x[None],
        np.zeros((1, 0)), [part.start]))
    np.testing.assert_array_equal(y, candidate.system.run(part.inputs, x, start=part.start))
    at, slopes = np.array([u.coordinate(get(candidate, u)) for u in unknowns]), found[:, :by.count]
    for column, k in enumerate(order):
        step = 1e-4 * np.eye(len(at))[k]
        moved = [problem.candidate(at + way * step) for way in (1.0, -1.0)]
        exact = unknowns[k].name in ('idle', 'time_constant')
        above, below = (exact_run(part.inputs, one.effects[0]) if exact else
                        one.system.run(part.inputs, x, start=part.start) for one in moved)
        expected = (above - below) / 2e-4
        norm = None if exact else np.inf
        assert np.linalg.norm(slopes[:, column] - expected, norm) < 0.02 * np.linalg.norm(
            expected, norm)


def model(parameters=ALL):
    noise = Noise(0.5, {'p_L': 1e5}, {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01})
    return Model(LOAD, LOAD.constant_values() | LOAD.middle(), T,
                 (place('drift', 'K_ce', parameters, LOAD),), noise=noise)


def series_of(samples, start):
    inputs = inputs_of(samples)
    return Series({'u_m': inputs[:, 0], 'theta_d': inputs[:, 1],
                   'T_g': 30.0 * np.sin(np.arange(samples) / 90.0)}, T, start=round(1e9 * start))


@pytest.mark.parametrize('mode', ['one_step', 'free_run', 'observer'])
def test_live_is_offline_to_the_last_digit(mode):
    predictor = Analytical(model())
    series = series_of(3000, BEGIN + 0.7)
    stepper = predictor.stepper(mode)
    live = [stepper.step(u, y, series.start + k * 2_000_000) for k, (u, y) in enumerate(zip(
        predictor.inputs(series), series['T_g'].tolist(), strict=True))]
    np.testing.assert_array_equal(live, getattr(predictor, mode)(series))


@pytest.mark.parametrize('mode', ['one_step', 'free_run', 'observer'])
def test_after_the_end_it_is_the_plant_with_the_last_value(mode):
    late, plain = series_of(500, END + 1e6), replace(model(), effects=())
    np.testing.assert_allclose(getattr(Analytical(model()), mode)(late),
                               getattr(Analytical(plain), mode)(late), rtol=1e-9, atol=1e-9)


def test_a_model_file_keeps_it(tmp_path):
    write_model(model(), tmp_path / 'model.yaml')
    assert read_model(tmp_path / 'model.yaml').effects == model().effects


@pytest.mark.slow
def test_it_is_named_with_its_rate_and_when_it_began():
    """A motor that wears from the second third on, in a recording of three series with pauses."""
    rng = np.random.default_rng(1)
    t = T * np.arange(1500)
    truth = candidate_of({'rate': 0.03, 'idle': 8.0, 'begin': BEGIN, 'end': BEGIN + 22.0})
    series = []
    for k in range(3):
        u = 0.1 * sum(np.sin(f * t + rng.uniform(0.0, 6.0)) for f in (3.0, 11.0, 29.0))
        angle = 0.02 * np.sin((2.0 + k) * t)
        start = round(1e9 * (BEGIN + 9.5 * k))
        y = truth.system.run(np.column_stack([u, angle]), np.zeros(LOAD.order), start=start)
        series.append(Series({'u_m': u, 'theta_d': angle,
                              'T_g': y + 0.005 * np.std(y) * rng.standard_normal(len(y))},
                             T, start=start))
    found = trace(Recording(tuple(series)), None, LOAD)
    effect, = found.effects
    assert (effect.id, effect.port, effect.certain) == ('drift', 'K_ce', True)
    values = effect.placed.named
    assert values['rate'] == pytest.approx(0.03, rel=0.1)
    assert values['idle'] == pytest.approx(8.0, abs=0.5)
    assert (values['begin'], values['end']) == pytest.approx((BEGIN, BEGIN + 19.0 + t[-1]))
    shape, = found.shapes
    by_law = np.interp(shape.free.knots, shape.time, shape.values)
    assert np.mean(np.abs(shape.free.added - by_law) < 3.0 * shape.free.std_error) > 0.8
    assert 'The model lacks a drift of K_ce (from ' in sentence(found)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'ratio', 'share'), [('K_q', 1.1, 0.9), ('K_ce', 1.5, 0.2)])
def test_a_jump_is_named_with_its_size_and_time(name, ratio, share):
    """A supply that fails, a seal that tears: at once, early or late in three series."""
    rng = np.random.default_rng(3)
    samples, jump = 1500, 9.0 * share
    t = T * np.arange(samples)
    system = assemble(LOAD, VALUES | {name: ratio * VALUES[name]})
    system = replace(system, earlier=((round(1e9 * jump), assemble(LOAD, VALUES)),))
    series = []
    for k in range(3):
        u = 0.1 * sum(np.sin(f * t + rng.uniform(0.0, 6.0)) for f in (3.0, 11.0, 29.0))
        angle, start = 0.02 * np.sin((2.0 + k) * t), round(3e9 * k)
        y = system.run(np.column_stack([u, angle]), np.zeros(LOAD.order), start=start)
        series.append(Series({'u_m': u, 'theta_d': angle,
                              'T_g': y + 0.005 * np.std(y) * rng.standard_normal(samples)},
                             T, start=start))
    found = trace(Recording(tuple(series)), None, LOAD)
    effect, = found.effects
    assert (effect.id, effect.port) == ('drift', name)
    begin, _ = effect.placed.effect.course.interval(effect.placed.values)
    assert begin == pytest.approx(jump, abs=0.05)
    assert factor(effect.placed.values, begin) == pytest.approx(1.0 / ratio, rel=0.02)
    assert factor(effect.placed.values, begin + 0.2) == pytest.approx(1.0, abs=0.02)
