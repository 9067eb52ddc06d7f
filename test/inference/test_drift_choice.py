"""Parameters that drift, and those that only differ from one recording to the next."""
from dataclasses import replace

import numpy as np
import pytest
from traced_rig import fitted, PLANT, record, VALUES

from hydro_twin.fitting.parts import Part
from hydro_twin.inference.drift_choice import is_drift_preferred, stretch_of
from hydro_twin.inference.search import search
from hydro_twin.model import Model, place
from hydro_twin.recording.series import Recording

DRIFT = {'rate': 0.02, 'begin': 10.0, 'end': 33.0}


def in_turn(*stiffness):
    """Record three series, half a second apart, each with a coupling of its own."""
    series = [record(count=1, seed=k, values=VALUES | {'G': factor * VALUES['G']}).series[0]
              for k, factor in enumerate(stiffness)]
    return Recording(tuple(replace(one, start=10_000_000_000 + k * 3_500_000_000)
                           for k, one in enumerate(series)))


def drifting():
    """Record three series, ten seconds apart, while the coupling stiffens."""
    rig = Model(PLANT, VALUES, 0.002, (place('drift', 'G', DRIFT, PLANT),), substeps=4)
    rng = np.random.default_rng(0)
    return Recording(tuple(
        replace(one, columns=one.columns | {
            'T_g': rig.run(one) + 0.5 * rng.standard_normal(len(one))})
        for one in record(count=3, noise=0.0).series))


@pytest.mark.parametrize(('recorded', 'is_one'), [
    (lambda: in_turn(1.0, 1.3, 1.15), False), (drifting, True)])
def test_a_drift_is_distinguished_from_recordings_that_differ(recorded, is_one):
    fit, parts, _ = fitted(recorded())
    bare = fit.candidate
    drift = search(replace(bare, effects=(place('drift', 'G', DRIFT, PLANT),)), parts, 20)
    assert is_drift_preferred(drift, parts) == is_one


def test_windows_without_a_gap_are_of_one_recording():
    whole = Part(np.zeros((300, 1)), np.zeros(300), start=5)
    windows = [whole.cut(100 * k, 100 * (k + 1), 0.002) for k in range(3)]
    other = replace(whole, start=windows[-1].start + 10 ** 9)
    assert list(stretch_of([*windows, other], 0.002)) == [0, 0, 0, 1]
    at_once = [replace(whole, start=0)] * 2     # of rigs whose clocks say nothing
    assert list(stretch_of(at_once, 0.002)) == [0, 1]
