"""A curve that stands for a law without a name: found where the law is, and only there."""
from dataclasses import replace
import pickle

import numpy as np
import pytest
from traced_rig import fitted, PLANT, record

from hydro_twin.effects.curve import curve, KNOTS, values
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import effect_unknowns
from hydro_twin.inference import curve_or_names
from hydro_twin.inference.context import Context
from hydro_twin.inference.curve import (
    find_curve,
    has_equivalent_law,
    is_better,
    is_mostly_constant,
    LARGEST,
    signal_range,
)
from hydro_twin.inference.curve_or_names import with_curve
from hydro_twin.inference.effect_signals import effect_signals
from hydro_twin.inference.findings import finding, Selection
from hydro_twin.inference.screen import spans
from hydro_twin.inference.search import search
from hydro_twin.inference.structure import free_curves, is_significant_dependence
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named


def test_a_linear_rig_has_none():
    fit, train, test = fitted(record())
    assert find_curve(fit, train, test, free_curves(fit, train), 0) is None


@pytest.mark.slow
@pytest.mark.parametrize(('law', 'ports', 'shape'), [
    (('stiffening', 'coupling', {'cubic': 3e4}), {'coupling'}, lambda x: x**3),
    (('asymmetry', 'flow', {'imbalance': 0.2}), {'flow', 'spool'}, np.abs),
])
def test_is_the_law_but_for_a_straight_line(law, ports, shape):
    fit, train, test = fitted(record(law))
    found = find_curve(fit, train, test, free_curves(fit, train), 0)
    placed = found.placed
    assert placed.port.name in ports
    assert placed.effect.reads[0] in {'value', 'opening', 'twist'}
    assert found.gain.low > 0.9
    model = found.fit.candidate
    seen = [effect_signals(model, placed, part).signals[placed.effect.reads[0]] for part in train]
    x = np.concatenate(seen)[::20]      # as often as the rig was there
    x = x[(x > placed.values[0]) & (x < placed.values[1])]

    def bent(y):
        return y - np.polyval(np.polyfit(x / x.max(), y, 1), x / x.max())

    # Where a twist is nought no signal says: the angle of the motor is not measured.
    drawn = bent(values(placed, x))
    assert max(np.corrcoef(drawn, bent(shape(x - zero)))[0, 1]
               for zero in np.linspace(-0.3, 0.3, 61) * x.max()) > 0.98


@pytest.fixture(scope='module')
def uneven():
    """Return fit, parts that it was fitted to, those that it was not, and curves."""
    fit, train, test = fitted(record(('asymmetry', 'flow', {'imbalance': 0.2})))
    return fit, train, test, free_curves(fit, train)


@pytest.fixture(scope='module')
def found(uneven):
    return find_curve(*uneven, 0)


@pytest.mark.slow
def test_one_is_found_where_only_all_ports_together_show(uneven):
    fit, train, test, curves = uneven
    hidden = [replace(curve, p_value=1.0) for curve in curves]
    assert not any(is_significant_dependence(curve) for curve in hidden)
    assert find_curve(fit, train, test, hidden, 0) is not None


@pytest.mark.slow
def test_a_law_keeps_its_name_if_it_explains_most_of_the_curve_there(uneven, found):
    fit, train, test, curves = uneven

    def named(*effect):
        return search(replace(fit.candidate, effects=(place(*effect, PLANT),)), train, 40)

    right = named('asymmetry', 'flow', {'imbalance': 0.1})
    wrong = named('dead_zone', 'spool', {'width': 1e-6})
    assert not is_better(found, fit, right, curves, test)
    assert is_better(found, fit, wrong, curves, test)
    assert has_equivalent_law((found.placed.port, found.placed.effect.reads[0]), wrong, curves)


@pytest.mark.slow
@pytest.mark.parametrize('heavier', [True, False])
def test_a_name_beside_a_curve_goes_only_if_that_outweighs_it(uneven, found, monkeypatch, heavier):
    """The dead zone is not there, and helps a little without the curve."""
    fit, train, test, _ = uneven
    zone = place('dead_zone', 'spool', {'width': 1e-6}, PLANT)
    named = search(replace(fit.candidate, effects=(zone,)), train, 40)
    selection = Selection(named, (finding(fit, named, (), 0),))
    beside = search(replace(fit.candidate, effects=(zone, found.placed)), train, 40)
    monkeypatch.setattr(curve_or_names, 'find_curve', lambda *_: replace(found, fit=beside))
    monkeypatch.setattr(curve_or_names, '_contested', lambda *_: False)
    monkeypatch.setattr(curve_or_names, 'decompose_curve', lambda *_: None)
    if not heavier:
        monkeypatch.setattr(curve_or_names, 'outweighs', lambda *_: False)
    kept, curve_found, replaced = with_curve(
        selection, fit, Context(train, test, (0.0, 1.0), 0, lambda _: None))
    assert curve_found is not None
    if heavier:
        assert (kept.findings, replaced) == ((), selection)
    else:
        assert (kept, replaced) == (selection, None)


@pytest.mark.parametrize(('shape', 'constant'), [
    (lambda x: 1.0 + 0.0 * x, True), (lambda x: 1.0 + 3.0 * x, True),
    (lambda x: 1.0 + 3.0 * x**3, False), (lambda x: x**3, False), (lambda x: 0.0 * x, False)])
def test_a_constant_and_a_line_are_mostly_a_constant(shape, constant):
    """The line is the gain of the valve over again."""
    fit, train, _ = fitted(record(count=1, duration=1.2))
    port = next(port for port in PLANT.ports if port.name == 'flow')
    reach = spans(fit.candidate, train)[port]
    high = reach.signals['opening']
    added = 1e-3 * reach.value * shape(np.linspace(-1.0, 1.0, KNOTS))
    model = replace(fit.candidate, effects=(curve(port, 'opening', -high, high, added),))
    assert is_mostly_constant(replace(fit, candidate=model), train) == constant


def test_knots_lie_where_the_recording_went():
    """A curve may drive its own signal to where the rig never was, the more so the stronger."""
    plant = plant_named('cylinder')
    t = 0.002 * np.arange(1500)
    inputs = np.sin(2 * np.pi * t)[:, None]
    linear = Model(plant, {'tau': 0.05, 'K_v': 0.1}, 0.002, substeps=2)
    part = Part(inputs, linear.system.run(inputs, np.zeros(2)))
    ports = {(port.name, port.kind): port for port in plant.ports}
    rate, speed = ports['spool', 'rate'], ports['piston', 'speed']
    seen = np.empty((len(t), len(linear.system.step.H)))
    linear.system.run(inputs, np.zeros(2), seen=seen)
    most = np.abs(seen[:, plant.ports.index(rate)]).max()
    driven = replace(linear, effects=(
        curve(rate, 'value', -most, most, np.linspace(1.0, -1.0, KNOTS) * most),))
    value = effect_signals(driven, driven.effects[0], part).signals['value']
    assert np.abs(value).max() > 3 * most
    low, high = signal_range(driven, [part])
    assert -1.01 * most < low < high < 1.01 * most
    # The output is measured.
    placed = curve(speed, 'position', -1.0, 1.0, np.linspace(0.0, 5.0, KNOTS))
    low, high = signal_range(replace(linear, effects=(placed,)), [part])
    assert (low, high) == pytest.approx((part.measured.min(), part.measured.max()), abs=1e-3)


def test_values_of_a_curve_are_bounded():
    port = PLANT.ports[0]
    placed = curve(port, 'value', -1.0, 1.0, np.zeros(KNOTS), 2.5)
    for one in (placed, pickle.loads(pickle.dumps(placed))):
        assert {(u.lower, u.upper) for u in effect_unknowns(0, one)} == {(-2.5, 2.5)}


@pytest.mark.slow
def test_what_is_found_stays_within_what_its_port_carries(uneven, found):
    fit, train, *_ = uneven
    carried = spans(fit.candidate, train)[found.placed.port].value
    assert np.abs(found.placed.values[2:]).max() <= LARGEST * carried


def test_where_nothing_moves_there_is_no_curve(monkeypatch):
    """Though something is left that the ports foretell."""
    fit, train, test = fitted(record(count=1, duration=1.2))
    monkeypatch.setattr('hydro_twin.inference.curve.predicted_by_ports', lambda *_: (0.5, 0.0))
    assert find_curve(fit, train, test, [], 0) is None
