"""Searches for a law that the first one, from its own start, misses."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from traced_rig import fitted, PLANT, record, VALUES

from hydro_twin.fitting.output_error import free_run_error
from hydro_twin.fitting.parts import Part, parts_of
from hydro_twin.fitting.port_signals import simulate_port_signals
from hydro_twin.inference.refinement import refine
from hydro_twin.inference.search import search, search_sticking, unsearched
from hydro_twin.inference.select import fit_alternatives, fit_to_convergence, KEPT, leading
from hydro_twin.inference.starts import relocated
from hydro_twin.inference.stepwise import best_timing
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named, PLANTS
from hydro_twin.predictors.system import LINEAR
from hydro_twin.recording.series import Recording
from hydro_twin.simulation.simulate import simulate

STRIBECK = ('friction', 'motor', {'coulomb': 6.0, 'stribeck': 4.0, 'stribeck_velocity': 0.02})
HOMOTOPY = 'hydro_twin.inference.search.search_by_homotopy'
BIAS = ('bias', 'motor', {'offset': 2.0})


@pytest.mark.parametrize(('here', 'there', 'width'), [
    ('command', 'spool', 2e-6), ('spool', 'command', 0.03)])
def test_from_a_law_at_the_wrong_port_the_right_one_is_found(here, there, width):
    alone, parts, _ = fitted(record(('hysteresis', there, {'width': width}), noise=0.3))
    wrong = {'command': 0.03, 'spool': 2e-6}[here]
    fit = search(replace(alone.candidate, effects=(
        place('hysteresis', here, {'width': wrong}, PLANT),)), parts, 40)
    (moved,) = relocated(fit.candidate, parts)
    found = search(replace(alone.candidate, effects=moved.effects), parts, 40)
    (placed,) = found.candidate.effects
    assert (placed.effect.id, placed.port.name) == ('hysteresis', there)
    # Lengths at the spool are known up to its gain, which the flow gain makes up for.
    volt = found.candidate.values['K_sv'] / VALUES['K_sv'] if there == 'spool' else 1.0
    assert placed.named['width'] == pytest.approx(width * volt, rel=0.05)
    assert found.error == pytest.approx(0.3, rel=0.1)
    assert fit.error > 1.05 * found.error


def test_a_bias_may_sit_at_any_of_three_ports():
    alone, parts, _ = fitted(record(BIAS))
    fit = search(replace(alone.candidate, effects=(place(*BIAS, PLANT),)), parts, 40)
    moved = [search(candidate, parts, 40) for candidate in relocated(fit.candidate, parts)]
    assert {fit.candidate.effects[0].port.name for fit in moved} == {'command', 'sensor'}
    for other in moved:
        assert other.error == pytest.approx(fit.error, rel=1e-3)


@pytest.mark.parametrize('moving', [False, True])
def test_whether_a_command_moves_between_samples_shows_at_a_rate_limit(moving):
    limit = ('rate_limit', 'spool', {'limit': 1e-3})
    rig = replace(PLANT, inputs=tuple(replace(one, held=not moving and one.held)
                                      for one in PLANT.inputs))
    alone, parts, _ = fitted(record(limit, noise=0.05, plant=rig,
                                    bus=1e-6 if moving else PLANT.sample_time))
    candidate = replace(alone.candidate, substeps=8, effects=(place(*limit, PLANT),))
    held = search(candidate, parts, 40)
    found = best_timing(held, parts)
    if moving:
        assert found.candidate.interpolation == LINEAR
        assert found.error < 1.05 * 0.05 < held.error
    else:
        assert found is held


def test_a_timing_that_was_left_at_an_edge_is_searched_again_from_the_stamps():
    """Of a cylinder whose lag a fit without the limit had taken for commands sent early."""
    plant = plant_named('cylinder')
    values, limit = {'tau': 0.006, 'K_v': 0.03}, {'lower': -6.0, 'upper': 6.0}
    steps = np.random.default_rng(0).uniform(-9.0, 9.0, 100)
    one = simulate(plant, values, [place('saturation', 'command', limit, plant)],
                   {'command': lambda t: steps[(2.5 * np.atleast_1d(t)).astype(int)]}, 20.0,
                   sample_time=0.01)
    one.columns['x'][:] += 1e-4 * np.random.default_rng(1).standard_normal(len(one))
    parts = parts_of(Recording((one,)), plant)
    late = Model(plant, {'tau': 0.0158, 'K_v': 0.03}, 0.01,
                 (place('saturation', 'command', limit, plant),), {'command': -0.01}, substeps=2)
    left = unsearched(late, parts)
    assert left.at_bound() == ['timing:command']
    found = best_timing(left, parts)
    assert found.cost < 0.9 * left.cost
    assert found.candidate.values['tau'] == pytest.approx(0.006, rel=0.1)
    assert abs(found.candidate.timing['command']) < 1e-3


@pytest.mark.slow
def test_an_earlier_effect_is_refined_where_another_follows_it():
    alone, parts, _ = fitted(record(STRIBECK, BIAS, noise=0.1))
    plain = tuple(place(*effect, PLANT) for effect in (
        ('friction', 'motor', {'coulomb': 6.0}), BIAS))
    fit = search(replace(alone.candidate, effects=plain), parts, 40)
    finer = refine([fit], parts, 0)[0]
    assert [p.effect.id for p in finer.candidate.effects] == ['friction', 'bias']
    friction = finer.candidate.effects[0].named
    assert friction['stribeck'] == pytest.approx(4.0, rel=0.1)
    assert friction['stribeck_velocity'] == pytest.approx(0.02, rel=0.2)
    assert finer.error == pytest.approx(0.1, rel=0.1)
    assert fit.error > 1.2 * finer.error
    assert free_run_error(finer.candidate, parts) < free_run_error(fit.candidate, parts)


@pytest.mark.slow
def test_a_ripple_is_refined_by_its_harmonics():
    waves = {'cosine': 4.0, 'sine': 2.0, 'periods': 300.0, 'sine_2': -2.0, 'cosine_3': 1.0}
    alone, parts, _ = fitted(record(('ripple', 'motor', waves), noise=0.2))
    plain = place('ripple', 'motor', {'cosine': 1.0, 'sine': 1.0, 'periods': 300.0}, PLANT)
    fit = search(replace(alone.candidate, effects=(plain,)), parts, 40)
    (ripple,) = refine([fit], parts)[0].candidate.effects
    for name, value in waves.items():
        assert ripple.named[name] == pytest.approx(value, rel=0.05, abs=0.1)


@pytest.mark.slow
def test_a_delay_that_lags_and_inertia_had_made_up_for():
    both = ('delay', 'command', {'time': 0.008}), ('dead_zone', 'spool', {'width': 4e-6})
    alone, parts, _ = fitted(record(*both, noise=0.3))
    zone = replace(alone.candidate, effects=(place(*both[1], PLANT),))
    base = search(zone, parts, 40)
    first, *_ = fit_alternatives(base, parts, (0.0, 1.0), 8, afresh=False)
    assert first.id == 'delay'
    assert first.placed.named['time'] == pytest.approx(0.008, rel=0.1)
    assert first.fit.error < 0.99 * base.error


@pytest.mark.slow
def test_an_orifice_is_found_that_is_much_weaker_than_any_start():
    weak = ('orifice', 'flow', {'supply_pressure': 4e8})        # 60 times the load pressure
    others = ('hysteresis', 'spool', {'width': 4e-6}), ('backlash', 'coupling', {'gap': 1e-4})
    alone, parts, _ = fitted(record(*others, weak, noise=0.05))
    beside = tuple(place(*other, PLANT) for other in others)
    base = search(replace(alone.candidate, effects=beside, substeps=4), parts, 40)
    first, *_ = fit_alternatives(base, parts, (0.0, 1.0), 8, afresh=False)
    assert first.id == 'orifice'
    assert first.placed.named['supply_pressure'] == pytest.approx(4e8, rel=0.05)
    assert first.fit.error == pytest.approx(0.05, rel=0.05)


@pytest.mark.slow
def test_a_ripple_is_found_in_less_than_half_a_period_of_it():
    waves = {'cosine': 4.0, 'sine': -2.0, 'periods': 30.0}
    alone, parts, _ = fitted(record(('ripple', 'motor', waves), noise=0.1))
    ripple = place('ripple', 'motor', waves, PLANT)
    angle = np.concatenate(simulate_port_signals(alone.candidate, parts))[
        :, PLANT.signal_row(ripple.port, 'position')]
    assert 0.1 < np.ptp(angle) * waves['periods'] / (2.0 * np.pi) < 0.4
    first, second, *_ = fit_alternatives(alone, parts, (0.0, 1.0), 8, afresh=True)
    assert first.id == 'ripple'
    assert first.placed.named['periods'] == pytest.approx(30.0, rel=0.05)
    assert first.fit.error == pytest.approx(0.1, rel=0.05)
    assert second.id == 'ripple' or second.fit.error > 1.2 * first.fit.error


@pytest.mark.slow
def test_what_needs_no_refinement_stays_as_it_is():
    alone, parts, _ = fitted(record(('friction', 'motor', {'coulomb': 6.0}), BIAS))
    finer = replace(alone.candidate, substeps=4)    # so that no refinement makes up for the steps
    placed = (place('friction', 'motor', {'coulomb': 6.0}, PLANT), place(*BIAS, PLANT))
    fit = search(replace(finer, effects=placed), parts, 40)
    assert refine([fit], parts, 0) == [fit]
    assert refine([fit], parts) == [fit]        # a bias has none


@pytest.mark.slow
def test_a_refinement_that_nothing_needs_any_more_is_taken_out():
    alone, parts, _ = fitted(record(('friction', 'motor', {'coulomb': 6.0}), BIAS))
    finer = replace(alone.candidate, substeps=4)    # so that no refinement makes up for the steps
    placed = (place('friction', 'motor', {'coulomb': 6.0, 'bristle_stiffness': 1e5}, PLANT),
              place(*BIAS, PLANT))
    fit = search(replace(finer, effects=placed), parts, 40)
    assert len(fit.unknowns) == len(refine([fit], parts, 0)[0].unknowns) + 1
    friction = refine([fit], parts, 0)[0].candidate.effects[0].named
    assert friction['bristle_stiffness'] == float('inf')
    assert friction['coulomb'] == pytest.approx(6.0, rel=0.02)


def test_what_sticks_and_leaves_structure_is_searched_by_homotopy(monkeypatch):
    searched = []
    monkeypatch.setattr(HOMOTOPY, lambda fit, *_: searched.append(fit) or fit)
    alone, parts, _ = fitted(record(STRIBECK, noise=0.3))
    search_sticking(alone, parts)                       # structure, but nothing that sticks
    right = search(replace(alone.candidate, substeps=8, effects=(place(*STRIBECK, PLANT),)),
                   parts, 40)
    search_sticking(right, parts)                       # nothing but noise
    assert not searched
    weak = unsearched(replace(right.candidate, effects=(
        place('friction', 'motor', {'coulomb': 1.0}, PLANT),)), parts)
    assert search_sticking(weak, parts) is weak
    assert searched == [weak]


def test_a_plant_that_integrates_is_not_searched_by_homotopy(monkeypatch):
    """With feedback a force that it lacks moves it by next to nothing."""
    monkeypatch.setattr(HOMOTOPY, lambda *_: pytest.fail('searched'))
    plant = PLANTS['positioning']
    model = Model(plant, plant.constant_values() | plant.middle(), plant.sample_time,
                  (place('friction', 'motor', {'coulomb': 10.0}, plant),))
    inputs = 50.0 * np.sin(0.05 * np.arange(500.0))[:, None]
    part = Part(inputs, model.system.run(inputs, np.zeros(2)) + np.cos(0.2 * np.arange(500.0)))
    fit = unsearched(model, [part])
    assert search_sticking(fit, [part]) is fit


def test_with_the_first_of_delay_lag_and_mode_the_others_go_on_each_at_its_best_port():
    alone, parts, _ = fitted(record(BIAS, duration=1.0))
    mode, lag = {'natural_frequency': 50.0, 'damping_ratio': 0.5}, {'time_constant': 0.01}
    ranked = [unsearched(replace(alone.candidate, effects=(place(*effect, PLANT),)), parts)
              for effect in (('mode', 'command', mode), ('mode', 'sensor', mode),
                             ('lag', 'sensor', lag), ('lag', 'command', lag), BIAS,
                             ('bias', 'sensor', {'offset': 1.0}),
                             ('bias', 'command', {'offset': 1.0}),
                             ('delay', 'command', {'time': 0.01}))]
    kept, left = leading(ranked)
    order = {id(fit): k for k, fit in enumerate(ranked)}
    assert KEPT == 4
    assert [order[id(fit)] for fit in kept] == [0, 2, 4, 5, 7]
    assert [order[id(fit)] for fit in left] == [1, 3, 6]
    kept, left = leading(ranked[4:7])
    assert (len(kept), left) == (3, [])


def test_a_lag_of_the_command_may_be_one_of_the_sensor_which_has_a_law_of_its_own():
    alone, parts, _ = fitted(record(BIAS, duration=1.0))
    of_command = place('lag', 'command', {'time_constant': 0.01}, PLANT)
    (moved,) = relocated(replace(alone.candidate, effects=(of_command,)), parts)
    assert moved.effects == (place('lag', 'sensor', {'time_constant': 0.01}, PLANT),)
    assert moved.effects[0].effect is not of_command.effect


def test_where_there_is_nothing_to_try_nothing_is_found():
    base, parts, _ = fitted(record(count=1))
    assert fit_to_convergence(base, [], parts) == []
