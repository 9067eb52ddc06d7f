"""Initial states of runs, against the states that made the data."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_twin.fitting.elimination import eliminate, eliminate_with_reruns
from hydro_twin.fitting.initial_state_search import InitialStateSearch
from hydro_twin.fitting.initial_states import InitialStates
from hydro_twin.fitting.output_error import fitted_residuals, initial_states, residuals
from hydro_twin.fitting.parts import Part, parts_of
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import effect_unknowns, plant_unknowns
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Recording
from hydro_twin.simulation.simulate import simulate

FREE = (-np.inf, np.inf)        # margins of what has none


def axis(*effects):
    plant = plant_named('positioning')
    return Model(plant, {'M': 100.0, 'F_v': 200.0}, plant.sample_time,
                 tuple(place(*effect, plant) for effect in effects), substeps=2)


def run_from(candidate, state, seconds=0.5):
    time = candidate.sample_time * np.arange(round(seconds / candidate.sample_time))
    inputs = 60.0 * np.cos(2 * np.pi * time)[:, None]
    return Part(inputs, candidate.system.run(inputs, np.array(state)))


@pytest.mark.parametrize('effects', [(), (('friction', 'motor', {'coulomb': 20.0}),)])
@pytest.mark.parametrize('velocity', [0.1, -0.1])
def test_a_part_that_begins_in_motion_starts_in_motion(effects, velocity):
    """Also where friction would hold it at rest, so that no small push tells anything."""
    candidate = axis(*effects)
    part = run_from(candidate, [velocity, 0.2])
    start = initial_states(candidate, [part])
    assert start.x[0] == pytest.approx([velocity, 0.2], rel=0.02)
    assert residuals(candidate, [part])[0] == pytest.approx(0.0, abs=0.01 * np.ptp(part.measured))


def turning_back():
    """Move an axis with friction that turns back within its first samples; starts at 1.1, 0.1."""
    plant = plant_named('positioning')
    model = Model(plant, {'M': 1.0, 'F_v': 3.0}, 1e-3,
                  (place('friction', 'motor', {'coulomb': 20.0}, plant),), substeps=4)
    time = 1e-3 * np.arange(300)
    inputs = (60.0 * np.sin(2.0 * np.pi * 3.0 * time + 3.0) - 25.0)[:, None]
    measured = model.system.run(inputs, np.array([1.1, 0.1]))
    assert 10 < np.argmax(measured) < model.start_up
    return model, Part(inputs, measured)


def test_the_initial_state_is_found_where_the_motion_turns_back_in_the_first_samples():
    """Where friction turns, too, no small change of the velocity tells anything."""
    model, part = turning_back()
    start = initial_states(model, [part])
    assert start.x[0] == pytest.approx([1.1, 0.1], rel=1e-6)


@pytest.mark.parametrize('state', [[1.1, 0.1], [1.05, 0.1], [-1.0, 0.3], [0.0, 0.1]])
def test_the_initial_state_is_found_from_that_under_a_similar_model(state):
    """Near that, or on the other side of the friction, which a search from there cannot leave."""
    model, part = turning_back()
    found = initial_states(model, [part])
    near = replace(found, x=np.array([state]), rms=1e-4 * np.ones(1))
    assert initial_states(model, [part], near).x[0] == pytest.approx([1.1, 0.1], rel=1e-3)


@pytest.mark.parametrize('effects', [(), (('dead_zone', 'command', {'width': 20.0}),)])
def test_a_search_leads_on_from_the_initial_state_under_a_similar_model(effects, monkeypatch):
    """And does not begin afresh where that ends as well as the state did under that model."""
    candidate = axis(*effects)
    part = run_from(candidate, [0.1, 0.2])
    found = initial_states(candidate, [part])
    near = replace(found, x=np.array([[0.05, 0.21]]), rms=1e-4 * np.ones(1))
    monkeypatch.setattr(
        InitialStateSearch, 'from_rest', lambda *_: pytest.fail('began afresh'))
    assert initial_states(candidate, [part], near).x[0] == pytest.approx([0.1, 0.2], rel=0.02)


def test_what_sticks_starts_at_rest_whatever_the_noise():
    candidate = axis(('friction', 'motor', {'coulomb': 80.0}))
    part = run_from(candidate, [0.0, 0.2])
    assert np.ptp(part.measured) == 0.0
    noisy = Part(part.inputs, part.measured + 1e-4 * np.random.default_rng(0).standard_normal(
        len(part.measured)))
    assert initial_states(candidate, [noisy]).x[0] == pytest.approx([0.0, 0.2], abs=2e-4)


def shaft(*effect):
    """Make a load simulator with an effect, and six seconds of it by another integrator."""
    plant = plant_named('load_simulator')
    values = plant.constant_values() | {p.name: (p.lower * p.upper) ** 0.5
                                        for p in plant.parameters}
    placed = place(*effect, plant)
    recorded = simulate(plant, values, [placed], {
        'u_m': lambda t: 0.05 * np.sin(2 * np.pi * 3.1 * t) + 0.05 * np.sin(2 * np.pi * 7.7 * t),
        'theta_d': lambda t: 0.02 * np.sin(2 * np.pi * 1.3 * t)}, 6.0)
    return Model(plant, values, plant.sample_time, (placed,), substeps=16), recorded


@pytest.mark.parametrize('effect', [
    ('backlash', 'coupling', {'gap': 3e-3}), ('hysteresis', 'command', {'width': 0.02})])
def test_a_cut_through_the_motion(effect):
    """The laws change with the side of a gap, or hang on what was before the cut."""
    candidate, recorded = shaft(*effect)
    errors = []
    for begin in range(100, len(recorded) - 150, 50):
        part, = parts_of(Recording((recorded.part(begin, begin + 150),)), candidate.plant)
        errors.append(rms(residuals(candidate, [part])[0]) / np.std(part.measured))
    assert np.quantile(errors, 0.9) < 0.002


def test_the_initial_states_of_parts_are_those_of_each_by_itself():
    """They are searched together, whatever their lengths, and which of them need a search."""
    candidate, recorded = shaft('backlash', 'coupling', {'gap': 3e-3})
    parts = [part for begin, length in ((100, 150), (1203, 400), (2306, 110))
             for part in parts_of(Recording((recorded.part(begin, begin + length),)),
                                  candidate.plant)]
    together = initial_states(candidate, parts)
    for k, part in enumerate(parts):
        alone = initial_states(candidate, [part])
        assert together.x[k] == pytest.approx(alone.x[0], rel=1e-9, abs=1e-300)
        assert together.z[k] == pytest.approx(alone.z[0], rel=1e-9, abs=1e-300)


def test_an_initial_state_that_still_fits_is_kept_and_another_is_searched_again():
    candidate = axis(('friction', 'motor', {'coulomb': 20.0}))
    part = run_from(candidate, [0.1, 0.2])
    found = initial_states(candidate, [part])
    kept = initial_states(candidate, [part], found)
    assert (kept.x == found.x).all()
    far = replace(found, x=found.x + np.array([0.0, 0.1]), rms=np.array([1e-9]))
    anew = initial_states(candidate, [part], far)
    assert anew.x[0] == pytest.approx(found.x[0], rel=1e-6)


def test_within_a_gap_the_initial_state_is_shown_by_the_side_that_is_met():
    """A tenth of a second at rest in the gap shows nothing of where in it."""
    candidate, recorded = shaft('backlash', 'coupling', {'gap': 3e-3})
    still = 120
    inputs = np.column_stack([recorded['u_m'], recorded['theta_d']])
    inputs[:still] = 0.0, inputs[still, 1]
    state = np.zeros(candidate.plant.order)
    state[candidate.plant.states.index('theta_j')] = inputs[0, 1] - 2e-3
    measured = candidate.system.run(inputs, state)
    assert np.ptp(measured[:50]) < 0.01 * np.ptp(measured)
    part = Part(inputs, measured)
    assert np.std(residuals(candidate, [part])[0]) < 0.01 * np.std(measured)


def one_part(samples):
    """Say where a part begins, is scored from, and ends."""
    return np.array([[0, 50, samples]])


def test_states_that_the_first_samples_do_not_distinguish_stay():
    """As those of a plant at an end stop: the start is met exactly, and nothing later."""
    residual = np.concatenate([np.full(50, 1e-9), np.linspace(1.0, 2.0, 100)])
    rest = eliminate(residual, np.ones((150, 2)), np.ones(2), one_part(150)).residual
    np.testing.assert_allclose(rest, residual[50:], rtol=1e-6)


def test_the_memory_of_an_effect_changes_within_its_margins():
    """A drift of the output is not that of a narrow play which starts far outside of its edges."""
    ramp = np.linspace(0.0, 1.0, 200)
    by_state = np.column_stack([np.ones(200), 50.0 * ramp])      # a state, and a memory
    residual = 3.0 * ramp                                        # as of a memory of 0.06
    free = eliminate(residual, by_state, np.ones(1), one_part(200))
    assert rms(free.residual) < 1e-3
    assert free.change[0, 1] == pytest.approx(0.06, rel=1e-3)
    narrow = eliminate(residual, by_state, np.ones(1), one_part(200),
                       margins=np.array([[FREE, [-0.01, 0.02]]]))
    assert narrow.change[0, 1] == pytest.approx(0.02)
    left = (residual - 1.0 * ramp)[50:]                          # 50 * 0.02 is explained
    assert rms(narrow.residual) <= rms(left)
    assert rms(narrow.residual) > 0.5 * rms(left)
    wide = eliminate(residual, by_state, np.ones(1), one_part(200),
                     margins=np.array([[FREE, [-0.1, 0.1]]]))
    np.testing.assert_allclose(wide.residual, free.residual, atol=1e-12)


def test_a_valve_begins_no_further_open_than_is_asked_for():
    """A stroke is not that of a valve that closes slowly, from an opening which none asked for."""
    plant = plant_named('cylinder')
    slow = Model(plant, {'tau': 0.5, 'K_v': 1e-3}, plant.sample_time)
    time = plant.sample_time * np.arange(500)
    part = Part(np.full((500, 1), 0.4), 0.3 * (1.0 - np.exp(-time / 0.5)))
    found = initial_states(slow, [part])
    assert found.x[0, 0] == pytest.approx(3.0 * 0.4)
    assert found.margins[0, 0] == pytest.approx([-6.0 * 0.4, 0.0])
    assert np.isinf(found.margins[0, 1]).all()
    assert rms(fitted_residuals(slow, [part])[0]) > 0.05


def test_a_memory_at_its_edge_follows_no_parameter():
    """What other unknowns do to the output is then not explained by it either."""
    ramp = np.linspace(0.0, 1.0, 200)
    by_state, others = (50.0 * ramp)[:, None], (2.0 * ramp)[:, None]
    margins = np.array([[[-0.01, 0.02]]])
    held = eliminate(3.0 * ramp, by_state, np.zeros(0), one_part(200), others, margins=margins)
    np.testing.assert_allclose(held.jacobian, others[50:])
    free = eliminate(0.5 * ramp, by_state, np.zeros(0), one_part(200), others, margins=margins)
    assert rms(free.jacobian) < 1e-3


def test_a_narrow_hysteresis_is_no_drift_of_a_valve_at_rest():
    """In windows of a cylinder that creeps, each its own way, a hysteresis explains nothing."""
    plant, values = plant_named('cylinder'), {'K_v': 0.02, 'tau': 0.05}
    T, rng = 0.05, np.random.default_rng(0)
    parts = []
    for creep in (-1e-3, 2e-3, 1.5e-3, -2e-3):
        command = np.repeat(rng.choice([-1.0, 0.0, 1.0], 8), 25)[:, None]
        system = Model(plant, plant.constant_values() | values, T).system
        moved = system.run(command, np.zeros(plant.order))
        parts.append(Part(command, moved + creep * T * np.arange(200)))
    begun = Model(plant, plant.constant_values() | values, T,
                  (place('hysteresis', 'command', {'width': 1e-3}, plant),))
    linear = Problem(replace(begun, effects=()), plant_unknowns(plant, 'physical'), parts).solve()
    unknowns = [*plant_unknowns(plant, 'physical'), *effect_unknowns(0, begun.effects[0])]
    assert Problem(begun, unknowns, parts).solve().error > 0.8 * linear.error


def run_sine(_parts, initial, weights):
    """Run y = sin(t + x), measured with x = 1.3; no single linear step finds the phase."""
    time = np.linspace(0.0, 10.0, 400)
    phase = time + initial.x[0, 0]
    return eliminate(np.sin(time + 1.3) - np.sin(phase), np.cos(phase)[:, None], np.ones(1),
                     np.array([[0, 20, 400]]), np.sin(phase)[:, None], weights)


SINE = InitialStates(np.array([[1.0]]), np.empty((1, 0)), np.array([[FREE]]), np.ones(1))


def test_a_part_is_run_again_after_a_large_change_of_its_initial_state():
    once = run_sine(np.arange(1), SINE, None)
    left, moved = eliminate_with_reruns(run_sine, SINE)
    assert rms(left.residual) < 0.05 * rms(once.residual)
    assert moved.x[0, 0] == pytest.approx(1.3, abs=0.05)
    np.testing.assert_array_equal(left.residual, run_sine(np.arange(1), moved, left.weights)[0])


def test_in_a_search_the_residual_stays_the_predicted_one():
    """The Jacobian and the initial state are those of a rerun."""
    once = run_sine(np.arange(1), SINE, None)
    left, moved = eliminate_with_reruns(run_sine, SINE, in_search=True)
    np.testing.assert_array_equal(left.residual, once.residual)
    assert moved.x[0, 0] == 1.0 + once.change[0, 0]
    again = run_sine(np.arange(1), moved, once.weights)
    np.testing.assert_array_equal(left.jacobian, again.jacobian)
    assert not np.array_equal(again.residual, once.residual)


def test_an_initial_state_that_no_linear_step_improves_stays():
    """Where a rerun has a larger residual than predicted, the first run counts."""
    def run_from(parts, initial, weights):
        residual = np.where(initial.x[0, 0] == 0.0, np.linspace(1.0, 2.0, 100),
                            np.random.default_rng(0).standard_normal(100) * 9.0)
        return eliminate(residual, np.ones((100, 1)), np.ones(1), np.array([[0, 20, 100]]))

    begun = InitialStates(np.zeros((1, 1)), np.empty((1, 0)), np.empty((1, 0, 2)), np.ones(1))
    left, moved = eliminate_with_reruns(run_from, begun)
    np.testing.assert_array_equal(left.residual, run_from(np.arange(1), begun, None).residual)
    assert moved.x[0, 0] == 0.0
