"""Refined forms of a law that end where they change nothing."""
from dataclasses import replace

import pytest
from traced_rig import fitted, PLANT, record, VALUES

from hydro_twin.inference.refinement import unrefined_if_same
from hydro_twin.inference.search import unsearched
from hydro_twin.model import Model, place

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
