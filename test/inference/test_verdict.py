"""What may be said of the evidence of a trace."""
from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.signal import lfilter
from trace_by_hand import candidate, evidence

from hydro_twin.fitting.parts import Part
from hydro_twin.inference.curve import FittedCurve
from hydro_twin.inference.evaluate import result_of
from hydro_twin.inference.findings import Finding
from hydro_twin.inference.noise import BurstSamples, noise_floor
from hydro_twin.inference.probability import (
    min_null_probability,
    of_verdict,
    P_OTHER_LAW_MISFIT,
    P_OTHER_LAW_NOISY,
    P_OTHER_LAW_STRUCTURED,
    SAMPLES,
)
from hydro_twin.inference.search import search
from hydro_twin.inference.verdict import named_effects, verdict_of
from hydro_twin.model import place
from hydro_twin.plants import plant_named
from hydro_twin.report.summary import remainder_sentence, summarise


@pytest.fixture(scope='module')
def rubbing():
    return evidence('load_simulator')


def test_an_error_of_many_times_the_noise_is_not_noise(rubbing):
    assert verdict_of(rubbing) == 'effect_found'
    nothing = replace(rubbing, findings=())
    assert verdict_of(nothing) == 'nothing_missing'
    loud = replace(nothing, floor=nothing.after.error / 8.0)
    assert verdict_of(loud) == 'unexplained'
    assert remainder_sentence(result_of(loud)) == (
        'the model does not fit, by 8 times the noise, so that nothing can be said of other '
        'effects; what is left depends on nothing that can be seen at the ports')
    very_loud = replace(nothing, floor=nothing.after.error / 1e6)
    assert 'by more than 1000 times the noise' in remainder_sentence(result_of(very_loud))


def test_where_the_model_does_not_fit_nothing_is_said_of_other_effects(rubbing):
    """What would have shown beside a fit that failed is no matter of the recording."""
    assert summarise(result_of(rubbing))['cannot_show']
    failed = replace(rubbing, findings=(), after=rubbing.before,
                     floor=rubbing.before.error / 8.0)
    summary = summarise(result_of(failed))
    assert (summary['verdict'], summary['cannot_show']) == ('unexplained', [])
    assert 'the model does not fit, by 8 times the noise' in summary['says']


def test_coloured_noise_may_look_five_times_as_large(rubbing):
    """As the documentation has it, of an AR(1) process of 0.93 a sample."""
    noise = lfilter([1.0], [1.0, -0.93], np.random.default_rng(0).standard_normal(20000))
    looks = noise.std() / noise_floor([noise])
    assert looks == pytest.approx(5.0, rel=0.1)
    coloured = replace(rubbing, findings=(), floor=rubbing.after.error / looks)
    assert verdict_of(coloured) == 'nothing_missing'
    assert summarise(result_of(coloured))['nothing'] == 0.5
    assert summarise(result_of(coloured))['says'].startswith('Nothing is found: ')


def test_nothing_is_missing_where_only_noise_is_left(rubbing):
    summary = summarise(result_of(replace(rubbing, findings=())))
    assert summary['nothing'] > 0.8
    assert summary['says'].startswith('Nothing is missing: ')


def without_rivals(evidence):
    return replace(evidence, findings=tuple(
        replace(finding, rivals=()) for finding in evidence.findings))


def test_a_law_is_certain_where_the_residual_is_white_and_no_rival_is_near(rubbing):
    alone = without_rivals(rubbing)
    assert all(one.certain for one in named_effects(alone))
    for doubt in ({'white': False}, {'floor': alone.after.error / 8.0},
                  {'held_out_ratio': 2.0}):
        assert not any(one.certain for one in named_effects(replace(alone, **doubt))), doubt


@pytest.mark.parametrize(('by_ports', 'certain'), [
    ((0.1, 0.02), False),       # a tenth is predicted, which noise would be once in fifty times
    ((0.1, 0.2), True), ((0.001, 0.02), True)])
def test_a_law_is_not_certain_where_the_ports_predict_what_is_left(rubbing, by_ports, certain):
    found = named_effects(replace(without_rivals(rubbing), by_ports=by_ports))
    assert [one.certain for one in found] == [certain] * len(found)


@pytest.mark.parametrize('distance', [0.0, 8.0, 40.0])
def test_what_the_data_do_not_decide_is_shared_with_the_rival(rubbing, distance):
    """Two laws share their probability as a coarsened posterior does, and no more than that."""
    (found, *_) = rubbing.findings
    rival = place('dead_zone', 'spool', {'width': 1e-6}, rubbing.plant)
    (alone, *_), (beside, *_) = (
        named_effects(replace(rubbing, findings=(replace(found, rivals=rivals),)))
        for rivals in ((), ((rival, distance),)))
    temper = SAMPLES / (SAMPLES + len(rubbing.after.main.residual))
    odds = math.exp(0.5 * temper * distance)
    assert beside.probability == pytest.approx(alone.probability * odds / (1.0 + odds))


def test_the_probabilities_of_the_verdicts_sum_to_one(rubbing):
    for found in (rubbing, replace(rubbing, findings=()),
                  replace(rubbing, findings=(), white=False, bursts=(BurstSamples(0, 0, 50),))):
        effects, verdict = named_effects(found), verdict_of(found)
        nothing, law_unknown = of_verdict(verdict, effects, much=False)
        named = 1.0 - nothing - law_unknown
        assert {'nothing_missing': nothing, 'unexplained': law_unknown,
                'effect_found': named}[verdict] > 0.8
        assert all(0.0 <= effect.probability <= named + 1e-12 for effect in effects)
        assert all(sum(effect.ports.values()) == pytest.approx(1.0) for effect in effects)


@pytest.mark.parametrize(('p_value', 'least'), [(0.01, 0.1113), (0.001, 0.0184)])
def test_a_p_value_is_worth_at_most_what_the_bound_says(p_value, least):
    """Table 1 of Sellke, Bayarri and Berger (2001): 0.11 and 0.018 for p of 0.01 and 0.001."""
    assert min_null_probability(p_value) == pytest.approx(least, abs=5e-4)


@pytest.mark.parametrize(('travel', 'others'), [(0.0, ['ripple']), (0.05, ['ripple']), (0.3, [])])
def test_a_constant_torque_may_be_a_ripple_where_the_motor_hardly_turns(travel, others):
    plant = plant_named('load_simulator')
    truth = candidate('load_simulator', [('bias', 'motor', {'offset': 2.0})])
    rng, time = np.random.default_rng(0), 0.002 * np.arange(1000)
    inputs = np.column_stack([0.05 * np.sin(9.0 * time), 0.5 * travel * np.sin(4.0 * time)])
    output = truth.system.run(inputs, truth.system.start(inputs[0], 0.0))
    part = Part(inputs, output + 0.01 * rng.standard_normal(len(output)))
    after = search(truth, [part], 3)
    found = replace(evidence('load_simulator'), plant=plant, after=after, fitted=[part],
                    findings=(Finding(0, 1e-30, 0.999, ()),))
    (judged,) = named_effects(found)
    assert [name for name, _ in judged.rivals] == others
    assert judged.close == tuple(others)
    assert not (others and judged.certain)


@pytest.mark.parametrize(('noise', 'missed', 'unknown'), [
    (0.2, 2.0, P_OTHER_LAW_MISFIT),           # 5 times the noise, and a fourth of what was missed
    (0.2, 4.0, P_OTHER_LAW_NOISY),    # as much, but a sixteenth only
    (0.5, 2.0, P_OTHER_LAW_STRUCTURED)])      # twice the noise, which may be coloured
def test_a_name_is_doubtful_where_much_is_left_that_cannot_be_noise(
        rubbing, noise, missed, unknown):
    before, after = (replace(rubbing.after, residual=error * np.ones(1000), lengths=(1000,))
                     for error in (missed, 1.0))
    found = replace(rubbing, white=False, before=before, after=after, floor=noise)
    assert {one.law_unknown for one in named_effects(found)} == {unknown}


def test_a_name_beside_a_curve_is_less_probable(rubbing):
    found = replace(rubbing, white=False)
    beside = replace(found, curve=FittedCurve(rubbing.after, rubbing.improvement, 0.0, ()))
    assert [{one.law_unknown for one in named_effects(traced)} for traced in (found, beside)] == [
        {P_OTHER_LAW_STRUCTURED}, {P_OTHER_LAW_NOISY}]


@pytest.mark.parametrize(('share', 'unknown'), [
    (0.6, P_OTHER_LAW_NOISY), (0.4, P_OTHER_LAW_MISFIT)])
def test_a_name_is_doubtful_where_more_is_left_than_it_explains(rubbing, share, unknown):
    """What is left is 0.96 of the mean square after it, and a twentieth of the one before."""
    before, after = (replace(rubbing.after, residual=error * np.ones(1000), lengths=(1000,))
                     for error in (4.5, 1.0))
    finding = replace(rubbing.findings[0], share=share)
    found = replace(rubbing, white=False, before=before, after=after, floor=0.2,
                    findings=(finding,))
    assert [one.law_unknown for one in named_effects(found)] == [unknown]


def test_what_held_out_data_do_not_prove_is_less_probable(rubbing):
    doubted = replace(rubbing, findings=tuple(
        replace(found, doubt=0.2) for found in rubbing.findings))
    for proven, one in zip(named_effects(rubbing), named_effects(doubted), strict=True):
        assert one.probability == pytest.approx(0.8 * proven.probability)
        assert proven.certain
        assert not one.certain


@pytest.mark.parametrize('ratio', [1.5, float('nan')])
def test_a_model_that_fails_on_held_out_data_lacks_something(rubbing, ratio):
    nothing = replace(rubbing, findings=())
    failed = replace(nothing, held_out_ratio=ratio)
    assert verdict_of(failed) == 'unexplained'
