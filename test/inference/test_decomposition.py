"""A free curve is decomposed into static laws, where they fit it."""
from dataclasses import replace

import numpy as np
import pytest

from hydro_twin.effects.curve import curve, KNOTS
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.curve import outweighs
from hydro_twin.inference.decomposition import decompositions, equivalents
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named

CYLINDER = plant_named('cylinder')
REACH = 3.0
KNOT = np.linspace(-REACH, REACH, KNOTS)


def driven(*effects, noise=0.0):
    """Return a cylinder with effects, and a run of it under levels held for half a second."""
    candidate = Model(CYLINDER, {'tau': 0.03, 'K_v': 0.01}, 0.01, tuple(effects))
    rng = np.random.default_rng(1)
    levels = np.append(rng.uniform(-REACH, REACH, 18), [-REACH, REACH])
    inputs = np.repeat(levels, 50)[:, None]
    output = candidate.system.run(inputs, candidate.system.start(inputs[0], 0.0))
    return candidate, [Part(inputs, output + noise * rng.standard_normal(len(output)))]


def at(port, kind):
    return next(one for one in CYLINDER.ports if (one.name, one.kind) == (port, kind))


def curve_of(law):
    """Return what a law adds to the command, as a curve."""
    return curve(at('command', 'command'), 'value', -REACH, REACH, law(KNOT) - KNOT)


def test_a_curve_of_one_law_is_that_law():
    uneven = curve_of(lambda v: np.where(v > 1.5, v - 1.5, np.minimum(v + 0.75, 0.0)))
    first, *_ = decompositions(*driven(uneven))
    only, = first.effects
    assert (only.effect.id, only.port.name) == ('dead_zone', 'command')
    edges = only.named['centre'] + only.named['width'] * np.array([-1.0, 1.0])
    assert edges == pytest.approx([-0.75, 1.5], abs=0.15)


def test_a_curve_of_two_laws_in_series_is_decomposed():
    both = curve_of(lambda v: np.clip(v - np.clip(v, -0.75, 0.75), -0.75, 0.75))
    first = next(one for one in decompositions(*driven(both)) if len(one.effects) == 2)
    zone, limit = first.effects
    assert (zone.effect.id, limit.effect.id) in {('dead_zone', 'saturation'),
                                                 ('dead_zone', 'rate_limit')}
    assert zone.named['width'] == pytest.approx(0.75, abs=0.15)


def test_a_curve_may_be_a_law_of_another_port_on_the_path():
    """The two slopes of a piston, which the curve has before the lag of the valve."""
    slopes = curve_of(lambda v: v + 0.2 * np.abs(v))
    first, *_ = decompositions(*driven(slopes))
    only, = first.effects
    assert (only.effect.id, only.port.name) == ('asymmetry', 'piston')
    assert only.named['imbalance'] == pytest.approx(0.2, abs=0.01)


def test_a_curve_that_no_law_fits_has_no_decomposition():
    wave = curve_of(lambda v: v + 0.7 * np.sin(np.pi * v / 0.75 + 0.5))
    assert decompositions(*driven(wave)) == []


def test_a_curve_over_another_signal_has_no_decomposition():
    over = curve(at('piston', 'speed'), 'position', -0.01, 0.01, 1e-3 * np.linspace(-1, 1, KNOTS))
    assert decompositions(*driven(over)) == []


@pytest.fixture(scope='module')
def bent():
    """Return runs of a cylinder with two slopes, and a fit to them for each that is asked for."""
    from hydro_twin.inference.search import search

    law = place('asymmetry', 'piston', {'imbalance': 0.2}, CYLINDER)
    _, parts = driven(law, noise=1e-5)

    def fit(*effects):
        candidate, _ = driven(*effects)
        return search(candidate, parts, 10)
    return fit, law, parts


def test_a_curve_that_finds_noise_only_where_a_law_leaves_much_outweighs_it(bent):
    fit, law, parts = bent
    wrong = fit(place('bias', 'command', {'offset': 0.1}, CYLINDER))
    assert outweighs(fit(curve_of(lambda v: v + 0.2 * np.abs(v))), wrong, parts)
    assert not outweighs(fit(curve_of(lambda v: v + 0.2 * np.abs(v))), fit(law), parts)


def test_what_is_smaller_than_the_error_of_both_outweighs_nothing(bent):
    """Beside a misfit that neither model explains."""
    fit, law, parts = bent
    curved, named = fit(curve_of(lambda v: v + 0.2 * np.abs(v))), fit(
        replace(law, values=(0.19,)))
    rough = [replace(part, measured=part.measured
                     + 1e-3 * np.sin(np.arange(len(part.measured)) / 20.0)) for part in parts]
    assert not outweighs(curved, named, rough)


def test_a_limit_of_the_speed_is_one_of_the_opening():
    """The speed follows the opening at once, so either law says the same."""
    limit = place('rate_limit', 'piston', {
        'limit': 0.015, 'imbalance': 0.2, 'softness': 0.2}, CYLINDER)
    candidate, parts = driven(limit)
    limited = next(model for model in equivalents(candidate, 0, parts)
                   if model.effects[0].effect.id == 'saturation')
    law, = limited.effects
    assert law.port.kind == 'opening'
    assert law.values == pytest.approx([-1.2, 1.8, 0.2], rel=0.02)
    inputs = parts[0].inputs
    np.testing.assert_allclose(limited.system.run(inputs, limited.system.start(inputs[0], 0.0)),
                               parts[0].measured, atol=2e-4)


def test_what_depends_on_more_than_its_port_has_no_equivalent():
    candidate, parts = driven(place('end_stop', 'piston', {'lower': -0.01, 'upper': 0.01},
                                    CYLINDER))
    assert equivalents(candidate, 0, parts) == []
