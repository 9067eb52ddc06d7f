"""What explains only a part of what is missing is not named; what explains it, is kept."""
from __future__ import annotations

from dataclasses import replace
from functools import cache

from coloured_noise import coloured
import numpy as np
import pytest
from traced_rig import fitted, PLANT, record

from hydro_twin.fitting.output_error import residuals
from hydro_twin.fitting.unknowns import unknowns_of
from hydro_twin.inference.context import Context
from hydro_twin.inference.criterion import whitened_gain
from hydro_twin.inference.findings import explained_share, Finding, Selection
from hydro_twin.inference.noise import cannot_be_noise, noise_floor
from hydro_twin.inference.refinement import is_distinguishable
from hydro_twin.inference.search import search
from hydro_twin.inference.select import Alternative
from hydro_twin.inference.stepwise import (
    exchange,
    is_significant,
    without_indistinct,
    without_unsupported,
)
from hydro_twin.inference.validation import _without_refuted, _without_unproven
from hydro_twin.model import place
from hydro_twin.recording.series import Recording
from hydro_twin.result import Improvement

FRICTION = ('friction', 'motor', {'coulomb': 10.0})
BIAS = ('bias', 'motor', {'offset': 2.0})


@pytest.fixture(scope='module')
def grown():
    """Return a function from effects to their fit, the fit without any, and a fresh context."""
    return growing(record(FRICTION, BIAS))


def growing(recording):
    alone, parts, held_out = fitted(recording)

    @cache
    def fit(*effects):
        placed = tuple(place(name, port, dict(values), PLANT) for name, port, values in effects)
        return search(replace(alone.candidate, effects=placed), parts, 40)

    def made(*effects):
        findings = tuple(Finding(k, 0.0, 0.5, ()) for k in range(len(effects)))
        found = fit(*((name, port, tuple(values.items())) for name, port, values in effects))
        return (Selection(found, findings), alone,
                Context(parts, held_out, (0.0, 1.0), 0, lambda _: None))

    return made


def names(selection):
    return [placed.effect.id for placed in selection.fit.candidate.effects]


def test_two_that_explain_everything_are_kept(grown):
    selection, alone, context = grown(FRICTION, BIAS)
    assert explained_share(alone, selection.fit) == pytest.approx(1.0, abs=0.02)
    assert names(without_unsupported(selection, alone, context)) == ['friction', 'bias']


def test_one_beside_a_larger_one_that_is_lacking_is_dropped(grown):
    selection, alone, context = grown(BIAS)
    assert explained_share(alone, selection.fit) < 0.5
    assert names(without_unsupported(selection, alone, context)) == []


@pytest.mark.parametrize(('coulomb', 'kept'), [(4.0, ['delay']), (12.0, [])])
def test_a_delay_that_leaves_more_than_noise_must_explain_half(coulomb, kept):
    """The friction is in the rig and not in the model."""
    delay = ('delay', 'command', {'time': 0.02})
    recorded = record(delay, ('friction', 'motor', {'coulomb': coulomb}))
    selection, alone, context = growing(recorded)(delay)
    assert (explained_share(alone, selection.fit) > 0.5) == bool(kept)
    assert cannot_be_noise(selection.fit.by_part)
    assert names(without_unsupported(selection, alone, context)) == kept


def noisy(clean, rms):
    return Recording(tuple(
        replace(one, columns={**one.columns, 'T_g': one['T_g'] + coloured(k, len(one), 0.9, rms)})
        for k, one in enumerate(clean.series)))


def test_a_delay_beside_coloured_noise_need_not_explain_the_noise():
    delay = ('delay', 'command', {'time': 0.02})
    selection, alone, context = growing(noisy(record(delay, noise=0.0), 3.0))(delay)
    assert cannot_be_noise(selection.fit.by_part)
    assert explained_share(alone, selection.fit) < 0.9
    assert names(without_unsupported(selection, alone, context)) == ['delay']


@pytest.mark.slow
def test_what_coloured_noise_leaves_is_nothing_that_is_missing():
    """Far more than white noise, with which the bias would explain less than half."""
    make = growing(noisy(record(FRICTION, BIAS, noise=0.0), 3.0))
    selection, alone, context = make(FRICTION, BIAS)
    assert selection.fit.error > 2.0 * noise_floor(selection.fit.by_part)
    assert explained_share(make(FRICTION)[0].fit, selection.fit) < 0.5
    assert names(without_unsupported(selection, alone, context)) == ['friction', 'bias']


def test_data_that_were_not_fitted_are_likelier_with_what_is_there(grown):
    selection, alone, context = grown(FRICTION, BIAS)
    before, after = (residuals(fit.candidate, context.held_out) for fit in (alone, selection.fit))
    n = sum(map(len, after)) - 6 * len(after)
    ratio = np.mean(np.square(np.concatenate(before))) / np.mean(np.square(np.concatenate(after)))
    # The noise is white, so that whitening by its memory changes little.
    assert whitened_gain(before, after) == pytest.approx(n * np.log(ratio), rel=0.05)
    assert whitened_gain(after, after) == 0.0
    assert whitened_gain(selection.fit.by_part, alone.by_part) < 0.0


def test_an_error_that_unusual_parameters_pay_for_is_no_gain_of_an_effect(grown):
    """A delay of nothing gained so, on a plant whose lag is outside its search box."""
    selection, alone, _ = grown(FRICTION, BIAS)
    assert is_significant(alone, selection.fit, 0.01)
    gain = float(alone.residual @ alone.residual - selection.fit.residual @ selection.fit.residual)
    for paid, so in ((0.9, True), (1.1, False)):
        paying = replace(selection.fit, penalty=alone.penalty + paid * gain)
        assert is_significant(alone, paying, 0.01) == so


@pytest.mark.slow
def test_the_best_fit_without_an_effect_is_remembered_in_the_order_of_the_chain(grown):
    """What an effect had drawn the others to is no good place to do without it."""
    selection, _, context = grown(FRICTION, BIAS)
    swapped = grown(BIAS, FRICTION)[0].fit
    astray = replace(selection.fit.candidate, effects=(
        *(place(name, port, {parameter: 1e3 * value}, PLANT)
          for name, port, parameter, value in (('friction', 'motor', 'coulomb', 10.0),
                                               ('bias', 'motor', 'offset', 2.0))),
        place('leakage', 'leakage', {'flow': 1e-9, 'exponent': 0.5}, PLANT)))
    third = Finding(2, 0.0, 0.5, ())
    lost = Selection(replace(selection.fit, candidate=astray), (*selection.findings, third))
    context.remember(swapped)
    fit, = context.without(lost.fit, [third.index])
    assert [placed.effect.id for placed in fit.candidate.effects] == ['friction', 'bias']
    assert fit.error == pytest.approx(swapped.error, rel=1e-3)


@pytest.mark.slow
def test_an_effect_is_proven_by_the_whole_interval_of_its_improvement(grown, monkeypatch):
    """However much likelier the data are with it."""
    selection, alone, context = grown(FRICTION, BIAS)
    assert names(_without_unproven(selection, alone, context)) == ['friction', 'bias']
    monkeypatch.setattr('hydro_twin.inference.validation.surer_improvement',
                        lambda before, after, seed: Improvement(0.3, -0.11, 0.65))
    assert names(_without_unproven(selection, alone, context)) == []


@pytest.mark.parametrize(('doubted', 'together', 'left'), [
    (0.07, 0.4, ['friction', 'bias']),
    (0.07, -0.1, []),               # not even both together surely help
    (0.3, 0.4, ['friction'])])
def test_what_is_not_proven_stays_beside_others_if_it_hardly_fails(
        grown, monkeypatch, doubted, together, left):
    selection, alone, context = grown(FRICTION, BIAS)
    helps = iter([Improvement(0.6, 0.03, 0.9), Improvement(0.3, -0.2, 0.7),   # with both in
                  Improvement(0.8, together, 0.9),
                  *[Improvement(0.5, together, 0.8)] * 2])                    # friction only
    module = 'hydro_twin.inference.validation'
    monkeypatch.setattr(f'{module}.surer_improvement', lambda *_: next(helps))
    monkeypatch.setattr(f'{module}.p_of_no_gain', lambda *_: doubted)
    monkeypatch.setattr(f'{module}.select_forward', lambda selection, *_: selection)
    monkeypatch.setattr(f'{module}.exchange', lambda selection, context, last: selection)
    proven = _without_unproven(selection, alone, context)
    assert names(proven) == left
    assert [found.doubt for found in proven.findings] == [0.0, 0.07][:len(left)]


def test_an_exchange_ends_where_two_laws_seem_better_in_turns(grown, monkeypatch):
    """As where the fit with finer steps is worse than the one that was preferred."""
    selection, alone, context = grown(FRICTION, BIAS)
    turns = []

    def made(candidate, residual):
        return replace(alone, candidate=candidate, unknowns=tuple(unknowns_of(candidate)),
                       residual=residual)

    def better(_, without, *__):
        if names(Selection(without)) != ['bias']:
            return []
        assert len(turns) < 9
        law = FRICTION if len(turns) % 2 else ('hysteresis', 'command', {'width': 0.1})
        turns.append(law[0])
        effects = (*without.candidate.effects, place(*law, PLANT))
        return [Alternative(made(replace(without.candidate, effects=effects),
                                 0.5 * selection.fit.residual))]

    module = 'hydro_twin.inference.stepwise'
    monkeypatch.setattr(Context, 'fit_alternatives', better)
    monkeypatch.setattr(Context, 'without', lambda _, fit, indices: [
        made(fit.candidate.without(k), alone.residual) for k in indices])
    monkeypatch.setattr(f'{module}.with_fine_steps', lambda fit, *_: made(
        fit.candidate, selection.fit.residual))
    assert set(names(exchange(selection, context, last=True))) == {'hysteresis', 'bias'}
    assert turns == ['hysteresis', 'friction']


def test_a_dead_zone_that_shrinks_to_nothing_about_a_centre_is_a_bias(grown):
    shrunk = ('dead_zone', 'command', {'width': 1e-6, 'centre': 0.02})
    selection, _, context = grown(shrunk, FRICTION)
    assert is_distinguishable(selection.fit, context.parts, 1)
    assert not is_distinguishable(selection.fit, context.parts, 0)
    simple = without_indistinct(selection, context)
    assert names(simple) == ['friction', 'bias']
    assert simple.indices == [0, 1]
    assert simple.fit.error < 1.01 * selection.fit.error


def test_what_is_distinguished_stays_as_it_is(grown):
    selection, _, context = grown(FRICTION, BIAS)
    assert without_indistinct(selection, context) == selection


@pytest.mark.slow
def test_after_an_effect_is_dropped_the_rest_is_chosen_again_and_grows(grown, monkeypatch):
    """A bias beside a leakage may be all that is left; friction is what is there, and a bias."""
    selection, alone, context = grown(('leakage', 'leakage', {'flow': 1e-7, 'exponent': 0.5}),
                                      BIAS)
    helps = iter([-0.1, 1.0])               # of each with both in
    module = 'hydro_twin.inference.validation'
    monkeypatch.setattr(f'{module}.surer_improvement',
                        lambda *_: Improvement(0.0, next(helps, 1.0), 1.0))
    assert names(_without_unproven(selection, alone, context)) == ['friction', 'bias']


def test_an_effect_that_another_replaces_as_a_simpler_law_stays(grown, monkeypatch):
    """Without the bias the hysteresis would be a constant: that it can is no proof against it."""
    selection, alone, context = grown(BIAS, ('hysteresis', 'command', {'width': 0.1}))
    # Of each with both in, of both together; of the one that is left, alone and together.
    helps = iter([-0.1, -0.1, -0.1, 1.0, 1.0])
    module = 'hydro_twin.inference.validation'
    monkeypatch.setattr(f'{module}.surer_improvement',
                        lambda *_: Improvement(0.0, next(helps), 1.0))
    monkeypatch.setattr(
        'hydro_twin.inference.stepwise.is_distinguishable',
        lambda fit, parts, index: names(Selection(fit)) != ['hysteresis'] or index != 0)
    monkeypatch.setattr(f'{module}.select_forward', lambda selection, *_: selection)
    monkeypatch.setattr(f'{module}.exchange', lambda selection, context, last: selection)
    assert names(_without_unproven(selection, alone, context)) == ['bias']


def test_a_limit_that_only_held_out_data_would_reach_is_taken_off():
    """The other end, put where the training data end, would refute the effect."""
    limits = {'lower': -1e9, 'upper': 0.1}
    alone, parts, _ = fitted(record(('saturation', 'command', limits), amplitude=0.05))
    _, _, beyond = fitted(record(('saturation', 'command', limits), amplitude=0.1, seed=1))
    limits['lower'] = min(part.inputs[:, 0].min() for part in parts)
    assert min(part.inputs[:, 0].min() for part in beyond) < 1.5 * limits['lower']
    fit = search(replace(alone.candidate, effects=(
        place('saturation', 'command', limits, PLANT),)), parts, 40)
    assert fit.candidate.effects[0].named['lower'] > -1.0
    kept = _without_unproven(Selection(fit, (Finding(0, 0.0, 0.5, ()),)), alone,
                             Context(parts, beyond, (0.0, 1.0), 0, lambda _: None))
    (placed,) = kept.fit.candidate.effects
    assert placed.named['lower'] == -1e9
    assert placed.named['upper'] == pytest.approx(0.1, rel=0.02)


def only_beside_a_bias(fit, _, index):
    """Say that the recording distinguishes a hysteresis only beside a bias."""
    return names(Selection(fit)) != ['hysteresis'] or index != 0


def test_both_stay_where_the_one_that_replaces_the_other_helps(grown, monkeypatch):
    selection, alone, context = grown(BIAS, ('hysteresis', 'command', {'width': 0.1}))
    helps = iter([-0.1, 1.0, -0.1])         # of each, and of both together
    module = 'hydro_twin.inference.validation'
    monkeypatch.setattr(f'{module}.surer_improvement',
                        lambda *_: Improvement(0.0, next(helps), 1.0))
    monkeypatch.setattr('hydro_twin.inference.stepwise.is_distinguishable', only_beside_a_bias)
    assert names(_without_unproven(selection, alone, context)) == ['bias', 'hysteresis']


@pytest.mark.parametrize('distinguished', [True, False])
def test_what_another_makes_up_for_only_as_a_simpler_law_is_not_needless(
        grown, monkeypatch, distinguished):
    selection, _, context = grown(BIAS, ('hysteresis', 'command', {'width': 0.1}))
    module = 'hydro_twin.inference.stepwise'

    def as_good(_, fit, indices):
        candidates = [fit.candidate.without(k) for k in indices]
        return [replace(fit, candidate=one, unknowns=tuple(unknowns_of(one)))
                for one in candidates]

    monkeypatch.setattr(Context, 'without', as_good)
    monkeypatch.setattr(Context, 'fit_alternatives', lambda *_: [])
    if not distinguished:
        monkeypatch.setattr(f'{module}.is_distinguishable', only_beside_a_bias)
    left = ['hysteresis'] if distinguished else ['bias', 'hysteresis']
    assert names(exchange(selection, context)) == left


@pytest.mark.parametrize(('gain', 'refuted'), [
    (Improvement(1e-4, 2e-5, 2e-4), False),         # sure, and next to nothing
    (Improvement(0.3, -0.1, 0.4), False),
    (Improvement(0.3, 0.2, 0.4), True),
])
def test_a_rival_is_refuted_where_held_out_data_tell_as_much_as_distinguishes_laws(
        grown, monkeypatch, gain, refuted):
    selection, _, context = grown(FRICTION, BIAS)
    rival = place('bias', 'sensor', {'offset': -2.0}, PLANT), 1.0
    friction, bias = selection.findings
    selection = replace(selection, findings=(friction, replace(bias, rivals=(rival,))))
    monkeypatch.setattr('hydro_twin.inference.validation.surer_improvement', lambda *_: gain)
    assert _without_refuted(selection, context).findings[1].rivals == (() if refuted else (rival,))
