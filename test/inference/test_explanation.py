"""The second search, by the likelihood of what the first one left."""
from __future__ import annotations

from dataclasses import replace

import pytest
import sampled_valve

from hydro_twin.effects import EFFECTS
from hydro_twin.fitting.coloured import is_coloured
from hydro_twin.inference import explanation, screen
from hydro_twin.inference.context import Context
from hydro_twin.inference.curve import FittedCurve
from hydro_twin.inference.explanation import explain
from hydro_twin.inference.findings import finding, Selection
from hydro_twin.inference.held_out import held_out_gain
from hydro_twin.inference.search import search
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named

PLANT, T = plant_named('cylinder'), sampled_valve.SAMPLE_TIME


@pytest.fixture(autouse=True)
def few_effects(monkeypatch):
    """Leave the laws that play a part here, to be quick."""
    monkeypatch.setattr(screen, 'EFFECTS', tuple(
        effect for effect in EFFECTS if effect.id in ('bias', 'dead_zone', 'saturation')))


@pytest.fixture(scope='module')
def recorded():
    """Cut a minute into windows of ten seconds, fit the linear plant, hold half a minute out."""
    train, held_out = ([sampled_valve.recorded(seed).cut(k, k + 200, T) for seed in seeds
                        for k in range(0, windows * 200, 200)]
                       for seeds, windows in (((1,), 6), ((3,), 3)))
    values = PLANT.constant_values() | {'K_v': 0.02, 'tau': 0.1}
    return (search(Model(PLANT, values, T, substeps=2), train, 40),
            Context(train, held_out, (0.0, 60.0), 0, lambda _: None))


@pytest.mark.slow
def test_where_both_searches_name_the_same_the_error_of_the_run_decides(recorded, monkeypatch):
    base, context = recorded
    no_wider_search(monkeypatch)
    found = explain(base, context, [])
    assert is_coloured(found.fit)
    zone, = found.fit.candidate.effects
    assert zone.effect.id == 'dead_zone'
    width, centre = zone.named['width'], zone.named['centre']
    assert centre - width == pytest.approx(sampled_valve.LOWER, abs=0.1)
    assert centre + width == pytest.approx(sampled_valve.UPPER, abs=0.1)
    assert found.fit.whitened is None
    there = place('dead_zone', 'command', {
        'width': 0.5 * (sampled_valve.UPPER - sampled_valve.LOWER),
        'centre': 0.5 * (sampled_valve.UPPER + sampled_valve.LOWER)}, PLANT)
    from_truth = search(replace(found.fit.candidate, effects=(there,)), context.parts, 60)
    assert found.fit.error < from_truth.error


@pytest.mark.slow
def test_an_offset_that_stood_for_a_dead_zone_is_replaced_by_likelihood(recorded, monkeypatch):
    def an_offset(base, context, known):
        fit = search(replace(base.candidate, effects=(
            place('bias', 'command', {'offset': 0.4}, PLANT),)), context.parts, 40)
        return base, Selection(fit, (finding(base, fit, (), 0),)), []

    monkeypatch.setattr(explanation, '_selected', an_offset)
    no_wider_search(monkeypatch)
    found = explain(*recorded, [])
    zone, = found.fit.candidate.effects
    assert zone.effect.id == 'dead_zone'
    assert found.fit.whitened is not None


def no_wider_search(monkeypatch):
    """Fail where several models are searched."""
    def wider(*_):
        raise AssertionError('several models are searched')
    monkeypatch.setattr(explanation, 'beam_search', wider)


def stub_searches(monkeypatch, *selections):
    """Let the searches end with these, in turn; each is a function of base and context.

    Returns:
        The models that a search from several models was given to start from, once it has begun.
    """
    ends, given = iter(selections), []

    def first_alternatives(base, context, known):
        given.extend(known)
        return []

    monkeypatch.setattr(explanation, '_selected', lambda base, context, known: (
        base, next(ends)(base, context), []))
    monkeypatch.setattr(explanation, '_improved', lambda selection, base, white: next(ends)(
        base, white))
    monkeypatch.setattr(explanation, '_first_alternatives', first_alternatives)
    monkeypatch.setattr(explanation, 'with_curve', lambda selection, base, context:
                        (selection, None, None))
    return given


def nothing(base, context):
    """Name no effect."""
    return Selection(base)


def a_zone(base, context, *more):
    """Name the dead zone, and more."""
    zone = place('dead_zone', 'command', {'width': 0.9, 'centre': -0.4}, PLANT)
    fit = search(replace(base.candidate, effects=(zone, *more)), context.parts, 40)
    return Selection(fit, tuple(finding(base, fit, (), k) for k in range(1 + len(more))))


def a_zone_and_a_limit(base, context):
    """Name a limit that is never reached as well."""
    return a_zone(base, context, place('saturation', 'command', {'lower': -99.0, 'upper': 99.0},
                                       PLANT))


@pytest.mark.slow
@pytest.mark.parametrize(('first', 'second', 'taken'), [
    (nothing, a_zone, True), (a_zone, nothing, False), (a_zone, a_zone_and_a_limit, False)])
def test_other_effects_are_taken_if_they_are_surely_better(
        recorded, monkeypatch, first, second, taken):
    stub_searches(monkeypatch, first, second)
    found = explain(*recorded, [])
    assert (found.fit.whitened is not None) == taken
    assert [placed.effect.id for placed in found.fit.candidate.effects] == ['dead_zone']


@pytest.mark.slow
@pytest.mark.parametrize('curve_is_better', [True, False])
def test_names_that_explain_too_little_stand_where_no_curve_outweighs_them(
        recorded, monkeypatch, curve_is_better):
    base, context = recorded
    zone, linear = a_zone(base, context), Selection(search(base.candidate, context.parts, 40))
    free, named = (zone, linear) if curve_is_better else (linear, zone)
    named = replace(named, findings=zone.findings)
    curve = FittedCurve(free.fit, held_out_gain(base, free.fit, context.held_out, 0), 0.0, ())
    stub_searches(monkeypatch, lambda *_: named)
    monkeypatch.setattr(explanation, 'is_coloured', lambda fit: False)
    monkeypatch.setattr(explanation, 'without_unsupported', lambda *_: Selection(base))
    monkeypatch.setattr(explanation, 'with_curve', lambda selection, *_: (selection, curve, None))
    found = explain(base, context, [])
    if curve_is_better:
        assert (found.curve, found.replaced) == (curve, named)
    else:
        assert (found.curve, found.selection.fit) == (None, named.fit)
        assert [one.supported for one in found.selection.findings] == [False]


@pytest.mark.slow
def test_a_search_from_several_models_begins_with_the_parameters_found_beside_each_effect(
        recorded, monkeypatch):
    """The lack of a dead zone biases those of the linear fit."""
    given = stub_searches(monkeypatch, a_zone, nothing)
    found = explain(*recorded, [])
    (start,) = given
    assert start.effects == found.fit.candidate.effects
    assert start.values == found.fit.candidate.values
    assert start.values['K_v'] > 1.1 * recorded[0].candidate.values['K_v']
