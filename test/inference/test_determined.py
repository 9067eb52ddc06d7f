"""An effect that has a state of its own, and no size that the data determine, is dropped."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from traced_rig import fitted, PLANT, record, VALUES

from hydro_twin.inference.determined import is_determined, without_undetermined
from hydro_twin.inference.findings import Finding, Selection
from hydro_twin.inference.search import search
from hydro_twin.model import place

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


def test_a_delay_is_determined_whatever_its_derivatives_say_beside_a_small_inertia():
    alone, parts, _ = fitted(
        record(('delay', 'command', {'time': 0.01}), noise=1.0, values=LIGHT, seed=1))
    placed = place('delay', 'command', {'time': 0.008}, PLANT)
    fit = search(replace(alone.candidate, effects=(placed,)), parts, 40)
    known = fit.identifiability()
    errors = dict(zip(known.coordinates, np.sqrt(np.diag(known.covariance)), strict=True))
    assert errors['0:time'] > 0.9
    assert fit.candidate.effects[0].values[0] == pytest.approx(0.01, rel=0.05)
    assert is_determined(fit, 0, parts)
