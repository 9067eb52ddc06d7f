"""Searches that begin with output feedback, on rigs of another integrator that stick and slip."""
from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.tracing.cases import case_of
from benchmarks.tracing.true_fit import true_structure
from hydro_twin.effects import Placed
from hydro_twin.fitting.homotopy import search_by_homotopy
from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import parts_of
from hydro_twin.inference.refinement import refine, unrefined
from hydro_twin.inference.search import LONG, search, TOLERANCE
from hydro_twin.model import place
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.recording.series import split

pytestmark = pytest.mark.slow

FRICTION_AND_RIPPLE, FRICTION_AND_SATURATION = 8655, 8104     # at steps of the command


def off(placed: Placed) -> Placed:
    """Make every effect smaller, and the breakaway of a friction a guess."""
    if placed.effect.id != 'friction':
        return replace(placed, values=tuple(0.7 * value for value in placed.values))
    coulomb = 0.7 * placed.named['coulomb']
    guess = {'coulomb': coulomb, 'stribeck': 0.1 * coulomb, 'stribeck_velocity': 0.05}
    return place('friction', placed.port.name, placed.named | guess, LOAD_SIMULATOR)


@pytest.mark.parametrize(('seed', 'stalls'), [(FRICTION_AND_RIPPLE, False),
                                              (FRICTION_AND_SATURATION, True)])
def test_a_mass_that_sticks_is_fitted_to_the_noise(seed: int, stalls: bool) -> None:
    """From the linear model, also where a search of free runs ends far above the noise."""
    rig = case_of(seed).rig()
    train, _ = split(rig.recording())
    parts = parts_of(train, LOAD_SIMULATOR)
    true = true_structure(rig)
    linear = fit_linear(LOAD_SIMULATOR, parts, LOAD_SIMULATOR.constant_values(),
                        true.sample_time, 0)
    start = replace(true, values=linear.candidate.values, effects=tuple(map(off, true.effects)))
    stuck = search(start, parts, LONG)
    assert (stuck.error > 1.2 * rig.truth.noise_rms) == stalls
    found = search_by_homotopy(stuck, parts, LONG, TOLERANCE)
    assert found.error < 1.01 * rig.truth.noise_rms
    for placed, truth in zip(found.candidate.effects, true.effects, strict=True):
        if placed.effect.id == 'friction':
            for name in ('coulomb', 'stribeck', 'stribeck_velocity'):
                assert placed.named[name] == pytest.approx(truth.named[name], rel=0.1)


@pytest.mark.parametrize('by_homotopy', [False, True])
def test_a_breakaway_is_found_from_sliding_friction(by_homotopy: bool) -> None:
    """With homotopy and, from forms of several Stribeck velocities, without it."""
    rig = case_of(FRICTION_AND_SATURATION).rig()
    train, _ = split(rig.recording())
    parts = parts_of(train, LOAD_SIMULATOR)
    true = true_structure(rig)
    friction, saturation = true.effects
    assert friction.effect.id == 'friction'
    sliding = search(replace(true, effects=(unrefined(friction), saturation)), parts, LONG)
    (found,) = refine([sliding], parts, 0, by_homotopy)
    assert found.error < 1.01 * rig.truth.noise_rms < 0.5 * sliding.error
    for name in ('coulomb', 'stribeck', 'stribeck_velocity'):
        assert found.candidate.effects[0].named[name] == pytest.approx(
            friction.named[name], rel=0.02)
