"""An effect that has a state of its own, and no size that the data determine, is dropped."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from traced_rig import fitted, PLANT, record, VALUES

from hydro_twin.fitting.parts import parts_of
from hydro_twin.inference.determined import is_determined, without_undetermined
from hydro_twin.inference.findings import Finding, Selection
from hydro_twin.inference.search import search
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording
from hydro_twin.simulation.simulate import simulate

FRICTION = ('friction', 'motor', {'coulomb': 10.0})
LIGHT = VALUES | {'J': 0.046, 'B_m': 52.0, 'K_p': 0.01, 'G': 8600.0}
HYSTERESIS = ('hysteresis', 'command', {'width': 1e-4})


def test_a_loop_that_is_not_there_is_dropped_and_friction_that_is_there_stays():
    alone, parts, _ = fitted(record(FRICTION))
    placed = tuple(place(*effect, PLANT) for effect in (FRICTION, HYSTERESIS))
    fit = search(replace(alone.candidate, effects=placed), parts, 40)
    assert [is_determined(fit, k, parts) for k in (0, 1)] == [True, False]
    findings = tuple(Finding(k, 0.0, 0.5, ()) for k in (0, 1))
    kept = without_undetermined(Selection(fit, findings), alone, parts)
    assert [placed.effect.id for placed in kept.fit.candidate.effects] == ['friction']
    assert [found.index for found in kept.findings] == [0]


def test_a_refinement_that_shares_the_size_of_a_law_is_dropped_before_the_law():
    """Friction that falls only beyond all speeds that were reached is one force, not two."""
    plant = plant_named('positioning')
    values = {'M': 20.0, 'F_v': 60.0}
    ends = np.random.default_rng(0).uniform(-80.0, 80.0, 40)
    one = simulate(plant, values, [place('friction', 'motor', {'coulomb': 20.0}, plant)],
                   {'force': lambda t: ends[(4.0 * np.atleast_1d(t)).astype(int)]}, 8.0)
    one.columns['x'][:] += 1e-3 * np.random.default_rng(1).standard_normal(len(one))
    parts = parts_of(Recording((one,)), plant)
    bare = Model(plant, values, plant.sample_time)
    split = place('friction', 'motor', {
        'coulomb': 10.0, 'stribeck': 10.0, 'stribeck_velocity': 30.0,
        'bristle_stiffness': 1e9}, plant)
    fit = search(replace(bare, effects=(split,)), parts, 40)
    assert not is_determined(fit, 0, parts)
    kept = without_undetermined(Selection(fit, (Finding(0, 0.0, 0.9, ()),)),
                                search(bare, parts, 40), parts)
    friction, = kept.fit.candidate.effects
    assert friction.values == pytest.approx((20.0, 0.0, 1.0, np.inf, 0.0), rel=0.01)


def test_a_delay_is_determined_whatever_its_derivatives_say_beside_a_small_inertia():
    alone, parts, _ = fitted(
        record(('delay', 'command', {'time': 0.01}), noise=1.5, values=LIGHT, seed=1))
    placed = place('delay', 'command', {'time': 0.008}, PLANT)
    fit = search(replace(alone.candidate, effects=(placed,)), parts, 40)
    known = fit.identifiability()
    errors = dict(zip(known.coordinates, np.sqrt(np.diag(known.covariance)), strict=True))
    assert errors['0:time'] > 0.9
    assert fit.candidate.effects[0].values[0] == pytest.approx(0.01, rel=0.05)
    assert is_determined(fit, 0, parts)


@pytest.mark.parametrize(('offset', 'left'), [(0.005, ['friction']), (0.5, ['friction', 'bias'])])
def test_an_offset_that_no_converter_resolves_is_dropped(offset, left):
    """A force of 3e-5 of its range moves a slide by far more than this sensor resolves."""
    plant = plant_named('positioning')
    values = {'M': 20.0, 'F_v': 60.0}
    ends = np.random.default_rng(0).uniform(-80.0, 80.0, 40)
    effects = tuple(place(name, 'motor', given, plant) for name, given in (
        ('friction', {'coulomb': 20.0}), ('bias', {'offset': offset})))
    one = simulate(plant, values, effects,
                   {'force': lambda t: ends[(4.0 * np.atleast_1d(t)).astype(int)]}, 8.0)
    one.columns['x'][:] += 1e-7 * np.random.default_rng(1).standard_normal(len(one))
    parts = parts_of(Recording((one,)), plant)
    model = Model(plant, values, plant.sample_time, effects=effects)
    fit, bare = search(model, parts, 40), search(replace(model, effects=()), parts, 40)
    assert fit.error < 0.5 * search(model.without(1), parts, 40).error
    findings = tuple(Finding(k, 0.0, 0.5, ()) for k in (0, 1))
    kept = without_undetermined(Selection(fit, findings), bare, parts)
    assert [placed.effect.id for placed in kept.fit.candidate.effects] == left
