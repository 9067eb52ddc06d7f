"""The free curve: its shape, where it may stand, and its place in a model file."""
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
import yaml

from hydro_twin.effects import EFFECTS
from hydro_twin.effects.curve import curve, KNOTS, values
from hydro_twin.errors import ModelError
from hydro_twin.model import document, Model, read_model, write_model
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.system import assemble

PLANT = PLANTS['load_simulator']
PORTS = {(port.name, port.kind): port for port in PLANT.ports}
FLOW = PORTS['flow', 'flow']
VALUES = PLANT.constant_values() | {p.name: (p.lower * p.upper) ** 0.5 for p in PLANT.parameters}


def run(effects=(), **changed):
    t = 0.002 * np.arange(1000)
    inputs = np.column_stack([0.4 * np.sin(10 * t), 0.01 * np.sin(7 * t)])
    return assemble(PLANT, VALUES | changed, effects).run(inputs, np.zeros(4))


def test_is_the_cubic_with_the_slopes_of_its_neighbours():
    added = np.random.default_rng(0).standard_normal(KNOTS)
    knots = np.linspace(-2.0, 3.0, KNOTS)
    slopes = np.gradient(added, knots)
    x = np.linspace(-2.0, 3.0, 333)
    np.testing.assert_allclose(values(curve(FLOW, 'opening', -2.0, 3.0, added), x),
                               CubicHermiteSpline(knots, added, slopes)(x), atol=1e-12)


def test_goes_straight_on_beyond_its_knots():
    placed = curve(FLOW, 'opening', -1.0, 1.0, np.arange(KNOTS) ** 2.0)
    step = 2.0 / (KNOTS - 1)
    first, last = 1.0 / step, (2 * KNOTS - 3) / step        # slopes between the outer knots
    np.testing.assert_allclose(values(placed, np.array([-1.5, -1.0, 1.0, 3.0])),
                               [-0.5 * first, 0.0, (KNOTS - 1)**2, (KNOTS - 1)**2 + 2 * last])


@pytest.mark.parametrize(('port', 'signal', 'reach', 'change'), [
    (('flow', 'flow'), 'opening', 1e-3, {'K_q': 1.1}),
    (('flow', 'flow'), 'value', 1e-3, {'K_q': 1.1}),
    (('spool', 'opening'), 'value', 1e-3, {'K_q': 1.1}),
    (('leakage', 'leakage'), 'load_pressure', 1e8, {'K_ce': 1.1}),
    (('coupling', 'coupling'), 'twist', 1.0, {'G': 1.1}),
])
def test_a_straight_one_is_another_gain(port, signal, reach, change):
    (name, factor), = change.items()
    slope = (factor - 1.0) * (1.0 if signal == 'value' else VALUES[name])
    line = curve(PORTS[port], signal, -reach, reach, slope * np.linspace(-reach, reach, KNOTS))
    expected = run(**{name: factor * VALUES[name]})
    assert np.abs(expected - run()).max() > 1e-3 * np.abs(expected).max()
    np.testing.assert_allclose(run([line]), expected, rtol=0, atol=1e-4 * np.abs(expected).max())


def test_competes_for_no_name():
    placed = curve(FLOW, 'opening', -1.0, 1.0, np.zeros(KNOTS))
    assert placed.effect.id not in {effect.id for effect in EFFECTS}


def model(placed):
    return Model(PLANT, PLANT.constant_values() | VALUES, 0.002, (placed,))


@pytest.mark.parametrize(('port', 'signal'), [
    (port, signal) for port in PLANT.ports for signal in ('value', *port.signals)],
    ids=lambda item: getattr(item, 'kind', item))
def test_a_model_file_keeps_it_and_says_that_it_explains_nothing(tmp_path, port, signal):
    placed = curve(port, signal, -0.5, 2.0, np.linspace(-1.0, 2.0, KNOTS) ** 2)
    write_model(model(placed), tmp_path / 'm.yaml')
    (entry,) = yaml.safe_load((tmp_path / 'm.yaml').read_text())['effects']
    assert (entry['id'], entry['signal'], entry['found']) == ('curve', signal, 'not explained')
    assert read_model(tmp_path / 'm.yaml').effects == (placed,)


@pytest.mark.parametrize(('change', 'says'), [
    ({'signal': 'twist'}, 'no curve over twist at port flow'),
    ({'kind': 'leakage'}, 'no curve over opening at port flow'),
    ({'parameters': {'low': {'value': 3.0}}}, 'low = 3 must be below high = 2'),
])
def test_a_curve_that_cannot_be_is_refused(tmp_path, change, says):
    whole = document(model(curve(FLOW, 'opening', -0.5, 2.0, np.ones(KNOTS))))
    entry = whole['effects'][0]
    entry['parameters'] |= change.pop('parameters', {})
    entry |= change
    (tmp_path / 'm.yaml').write_text(yaml.safe_dump(whole))
    with pytest.raises(ModelError, match=says):
        read_model(tmp_path / 'm.yaml')
