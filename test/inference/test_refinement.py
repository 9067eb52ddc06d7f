"""Refined forms of a law: those that change nothing, and those that only short runs lead to."""
from dataclasses import replace

import numpy as np
import pytest
from traced_rig import fitted, PLANT, record, VALUES

from hydro_twin.fitting.horizon import horizon_windows
from hydro_twin.fitting.parts import parts_of
from hydro_twin.inference.refinement import refine, unrefined_if_same
from hydro_twin.inference.search import LONG, search, unsearched
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.recording.series import Recording
from hydro_twin.simulation.simulate import simulate

DRIFT = {'rate': 0.02, 'begin': 10.0, 'end': 33.0}


@pytest.mark.parametrize(('time_constant', 'is_plain'), [(1e200, True), (5.0, False)])
def test_a_drift_that_settles_after_the_recording_goes_in_a_straight_line(
        time_constant, is_plain):
    _, parts, _ = fitted(record(count=3))
    rig = Model(PLANT, VALUES, 0.002)
    settling, straight = (
        unsearched(replace(rig, effects=(place('drift', 'G', DRIFT | more, PLANT),)), parts)
        for more in ({'time_constant': time_constant}, {}))
    found = unrefined_if_same(settling, parts, 0)
    assert (found is not settling) == is_plain
    if is_plain:
        assert found.candidate == straight.candidate
        assert len(found.unknowns) == len(settling.unknowns) - 1


@pytest.mark.slow
def test_bristles_and_breakaway_of_an_axis_are_found_from_short_windows():
    """From the simple law, a search on the whole runs ends at three times the error."""
    axis, rng = PLANTS['positioning'], np.random.default_rng(1)
    truth = {'coulomb': 8.0, 'stribeck': 6.0, 'stribeck_velocity': 0.02, 'bristle_stiffness': 4e4}
    series = []
    for k in range(2):
        f, phase = rng.uniform(0.4, 3.0, 5), rng.uniform(0.0, 2.0 * np.pi, 5)

        def force(t, f=f, phase=phase):
            t = np.floor(1000.0 * t + 1e-6) / 1000.0
            return 7.0 * np.sin(2.0 * np.pi * np.outer(t, f) + phase).sum(axis=1)

        run = simulate(axis, {'M': 15.0, 'F_v': 70.0}, [place('friction', 'motor', truth, axis)],
                       {'force': force}, 5.0, start=10_000_000_000 * (k + 1))
        noise = 1e-4 * rng.standard_normal(len(run))
        series.append(replace(run, columns=run.columns | {'x': run['x'] + noise}))
    parts = horizon_windows(parts_of(Recording(tuple(series)), axis), axis, 0.001)
    rig = Model(axis, {'M': 10.0, 'F_v': 150.0}, 0.001, substeps=2,
                effects=(place('friction', 'motor', {'coulomb': 6.0}, axis),))
    (found,) = refine([search(rig, parts, LONG)], parts)
    assert found.error < 2e-4
    assert found.candidate.values == pytest.approx({'M': 15.0, 'F_v': 70.0}, rel=0.1)
    law = found.candidate.effects[0].named
    assert {name: law[name] for name in truth} == pytest.approx(truth, rel=0.1)
