"""Which port and signal a residual depends on, where that is known."""
from dataclasses import replace
from functools import cache
from itertools import groupby

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim, lfilter
from traced_rig import fitted, PLANT, record, VALUES

from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.output_error import free_run
from hydro_twin.fitting.parts import Part, parts_of
from hydro_twin.fitting.port_signals import explained, predicted_by_ports
from hydro_twin.inference.screen import longest_run, screen, spans, undetectable
from hydro_twin.inference.search import LONG, search
from hydro_twin.inference.structure import (
    dependences,
    drift_test,
    hats,
    is_moving_offset,
    to_output,
)
from hydro_twin.inference.trace import trace
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.system import assemble
from hydro_twin.recording.series import Recording
from hydro_twin.report.summary import remainder_sentence


@pytest.fixture(scope='module')
def linear():
    return [fitted(record(seed=seed, count=3)) for seed in range(3)]


def test_a_linear_rig_depends_on_nothing(linear):
    for fit, train, _ in linear:
        assert dependences(fit, train) == []
        for share, p_value in (drift_test(fit, train), predicted_by_ports(fit, train)):
            assert p_value > 0.01
            assert share < 0.01


def with_offset(recording, offset):
    """Add an offset [N m], of time [s], to the torque measured."""
    return Recording(tuple(replace(one, columns=one.columns | {
        'T_g': one['T_g'] + offset(1e-9 * (one.stamps - recording.series[0].start))})
        for one in recording.series))


@pytest.mark.parametrize(('offset', 'moves'), [
    (lambda t: 0.4 * t, True),
    (lambda t: 4.0 * (t > 12.0), True),
    (lambda t: 4.0 + 0.0 * t, False)])
def test_the_zero_of_a_sensor_that_moves(offset, moves):
    """What follows time may follow a slow signal by chance, but no better."""
    recorded = with_offset(record(count=3), offset)
    fit, parts, _ = fitted(recorded)
    bias = place('bias', 'sensor', {'offset': 1.0}, PLANT)
    biased = search(replace(fit.candidate, effects=(bias,)), parts, LONG)
    assert is_moving_offset(fit, biased, parts) == moves
    found = dependences(biased, parts)
    assert [one.signal for one in found[:1]] == ['time'] * moves


@pytest.mark.slow
def test_a_law_that_imitates_an_offset_that_moves_is_not_named():
    found = trace(with_offset(record(count=3), lambda t: 0.4 * t), None, PLANT)
    assert (found.verdict, found.effects, found.curve) == ('unexplained', (), None)
    assert 'its mean moves with time' in remainder_sentence(found)


@pytest.mark.parametrize('gain', [0.0025, 0.01])
def test_noise_that_a_controller_answers_is_not_predicted(gain):
    """In closed loop the command of a sample holds the noise of the same."""
    recording = record(noise=0.0, count=3)
    rig, rng = assemble(PLANT, VALUES), np.random.default_rng(0)
    parts = []
    for part in parts_of(recording, PLANT):
        noise = 0.5 * rng.standard_normal(len(part.measured))
        u_m = part.inputs[:, 0] - gain * noise
        inputs = np.column_stack([u_m, part.inputs[:, 1]])
        moved = rig.run(inputs, np.zeros(4)) - rig.run(part.inputs, np.zeros(4))
        parts.append(replace(part, inputs=inputs, measured=part.measured + moved + noise))
    fit = fit_linear(PLANT, parts, PLANT.constant_values(), 0.002)
    fit = search(fit.candidate, parts, LONG)
    assert fit.error == pytest.approx(0.5, rel=0.02)
    assert predicted_by_ports(fit, parts)[1] > 0.05


LAWS = {   # law on its port, the ports at which it may be seen, the signals there
    'leakage': (('leakage', {'flow': 3e-6, 'exponent': 3.0}), {'leakage', 'flow'},
                {'load_pressure', 'value'}),
    'asymmetry': (('flow', {'imbalance': 0.2}), {'command', 'spool', 'flow'},
                  {'value', 'opening'}),
    'stiffening': (('coupling', {'cubic': 3e4}), {'coupling'}, {'value', 'twist'}),
    'dead_zone': (('spool', {'width': 2e-6}), {'flow', 'spool'}, {'value', 'opening'}),
    'friction': (('motor', {'coulomb': 6.0}), {'motor'}, {'velocity'}),
    'ripple': (('motor', {'cosine': 4.0, 'sine': 2.0, 'periods': 300.0}), {'motor'}, {'position'}),
}


@cache
def lacking(name):
    """Make a rig with one effect, and the linear fit to it."""
    return fitted(record((name, *LAWS[name][0]), count=3))


@pytest.mark.parametrize('name', LAWS)
def test_port_and_signal_of_a_law_are_found(name):
    """Some differ by a sign or a factor only; command and spool by a short lag."""
    _, ports, signals = LAWS[name]
    first = dependences(*lacking(name)[:2])[0]
    assert first.port.name in ports
    assert first.signal in signals
    assert first.share > 0.2
    assert first.p_value < 0.01


def test_the_curve_is_the_law():
    """Stiffening: what is left over the twist is a cubic, less a straight line."""
    first = dependences(*lacking('stiffening')[:2])[0]
    inside = slice(1, -1)                   # where there are samples enough
    x = first.knots[inside] / np.abs(first.knots).max()
    cubic = np.polynomial.Polynomial.fit(x, first.curve[inside], 3)
    assert np.std(first.curve[inside] - cubic(x)) < 0.35 * np.std(first.curve[inside])
    assert cubic.convert().coef[3] > 0.0


def test_a_port_reaches_the_output_as_the_laws_say(linear):
    """The difference equation from each port against scipy's, for what moves in straight lines."""
    candidate = linear[0][0].candidate
    laws = candidate.system.laws
    scale = np.diag([1e-5, 1e6, 1.0, 1e-2])
    A, C = np.linalg.solve(scale, laws.A @ scale), laws.C @ scale
    d = np.cumsum(np.random.default_rng(0).standard_normal(400))
    d -= d[0]
    equation = to_output(candidate)
    for index, port in enumerate(PLANT.ports):
        E = np.linalg.solve(scale, laws.E[:, [index]])
        direct = laws.port_d[-1:, [index]] + (port.kind == 'sensor')
        discrete = cont2discrete((A, E, C, direct), candidate.sample_time, 'foh')
        expected = dlsim(discrete, d)[1][:, 0]
        found = lfilter(equation.b[:, index], np.concatenate([[1.0], equation.a]), d)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_hats_add_up_to_one():
    knots = np.linspace(-1, 2, 9)
    values = np.random.default_rng(0).uniform(-1.5, 2.5, 500)
    columns = hats(values, knots)
    np.testing.assert_allclose(columns.sum(axis=1), 1.0)
    np.testing.assert_allclose(columns @ knots, np.clip(values, -1, 2))


def regression(seed, gain, columns=6, n=3000):
    rng = np.random.default_rng(seed)
    X = np.cumsum(rng.standard_normal((n, columns)), axis=0)
    X = X - X.mean(axis=0)
    basis, _ = np.linalg.qr(rng.standard_normal((n, 3)))
    signal = X[:, 0] / np.std(X[:, 0])
    return X, gain * signal + rng.standard_normal(n), basis


def test_dynamics_of_a_slow_recording_are_predicted():
    """At 20 Hz, too, what a signal does half a second later is no noise."""
    plant, sample_time, rng = PLANTS['cylinder'], 0.05, np.random.default_rng(0)
    command = rng.uniform(-4.0, 4.0, (1500, 1))
    model = Model(plant, plant.constant_values() | {'K_v': 0.02, 'tau': 0.1}, sample_time)
    share = 1.0 - np.exp(-sample_time / 0.5)
    later = lfilter([share], [1.0, share - 1.0], command[:, 0] ** 2)
    moved = model.system.run(command, np.zeros(plant.order)) + 1e-3 * (later - later.mean())
    parts = [Part(command, moved + 1e-4 * rng.standard_normal(len(moved)))]
    predicted, p_value = predicted_by_ports(search(model, parts, LONG), parts)
    assert predicted > 0.5
    assert p_value < 1e-3


def test_noise_is_not_predicted():
    p_values = [explained(*regression(seed, 0.0))[2] for seed in range(200)]
    assert np.mean(np.array(p_values) < 0.05) < 0.08


def test_a_share_is_the_signals():
    for seed in range(10):
        _, share, p_value = explained(*regression(seed, 1.0))
        assert share == pytest.approx(0.5, abs=0.06)
        assert p_value < 1e-3


def test_the_longest_that_something_holds():
    rng = np.random.default_rng(0)
    holds = rng.random((200, 5)) < [0.0, 0.3, 0.6, 0.9, 1.0]
    by_hand = [max(len(list(run)) if value else 0 for value, run in groupby(column))
               for column in holds.T]
    assert longest_run(holds).tolist() == by_hand
    assert by_hand[0] == 0
    assert by_hand[-1] == 200


def test_spans_are_what_a_run_reaches(linear):
    fit, train, _ = linear[0]
    reach = spans(fit.candidate, train)
    largest = max(np.abs(part.inputs[fit.candidate.start_up:, 0]).max() for part in train)
    by_name = {(port.name, port.kind): span for port, span in reach.items()}
    assert by_name['command', 'command'].value == pytest.approx(largest)
    torque = max(np.abs(free_run(fit.candidate, part)[fit.candidate.start_up:]).max()
                 for part in train)
    assert by_name['sensor', 'sensor'].value == pytest.approx(torque)
    twist = by_name['coupling', 'coupling'].signals['twist']
    assert twist * fit.candidate.values['G'] == pytest.approx(torque, rel=0.02)


def test_spans_do_not_hold_a_state_that_the_start_tells_badly():
    plant = PLANTS['valve_servo']
    command = np.column_stack([0.5 + 0.2 * np.sin(np.linspace(0.0, 9.0, 900))])
    noisy = 0.5 + 0.01 * np.random.default_rng(0).standard_normal(900)
    fast = Model(plant, {'T_y': 1e-4, 'T_c': 0.3, 'tau': 1e-4, 'k_1': 1.0}, 0.002)
    speed = next(span for port, span in spans(fast, [Part(command, noisy)]).items()
                 if port.name == 'actuator').value
    assert speed < 2.0      # the command needs 0.9; noise at the start would ask for hundreds


@pytest.mark.parametrize('name', ['friction', 'asymmetry', 'stiffening'])
def test_screening_puts_the_right_effect_first(name):
    fit, train, _ = lacking(name)
    scored = screen(fit, train)
    assert scored[0].placed.effect.id == name
    assert len(fit.residual) == sum(len(part.measured) - fit.candidate.start_up for part in train)
    assert all(0.0 <= p.share <= 1.0 + 1e-9 for p in scored)


def test_what_cannot_show_is_said(linear):
    fit, train, _ = linear[0]
    said = {(h.id, h.port): h.says for h in undetectable(fit, train)}
    assert 'beyond that cannot show' in said['saturation', 'spool']
    assert ('friction', 'motor') not in said
    quiet = fitted(record(amplitude=1e-5, noise=0.5, count=3))
    found = {one.id for one in undetectable(quiet[0], quiet[1])}
    assert found >= {'dead_zone', 'orifice', 'asymmetry'}


def test_columns_that_grow_without_bound_explain_nothing():
    rng = np.random.default_rng(0)
    shape, noise = rng.standard_normal((2, 1000))
    basis = np.linalg.qr(rng.standard_normal((1000, 2)))[0]
    wild = np.column_stack([np.exp(np.linspace(0.0, 700.0, 1000)), np.full(1000, np.nan), shape])
    alone = explained(shape[:, None], shape + noise, basis)
    weights, share, p_value = explained(wild, shape + noise, basis)
    np.testing.assert_allclose(weights, [0.0, 0.0, alone[0][0]])
    assert (share, p_value) == pytest.approx(alone[1:])
