"""An effect that has a state of its own, and no size that the data determine, is dropped."""
from __future__ import annotations

from dataclasses import replace

from traced_rig import fitted, PLANT, record

from hydro_twin.inference.determined import is_determined, without_undetermined
from hydro_twin.inference.findings import Finding, Selection
from hydro_twin.inference.search import search
from hydro_twin.model import place

FRICTION = ('friction', 'motor', {'coulomb': 10.0})
HYSTERESIS = ('hysteresis', 'command', {'width': 1e-4})


def test_a_loop_that_is_not_there_is_dropped_and_friction_that_is_there_stays():
    alone, parts, _ = fitted(record(FRICTION))
    placed = tuple(place(*effect, PLANT) for effect in (FRICTION, HYSTERESIS))
    fit = search(replace(alone.candidate, effects=placed), parts, 40)
    assert [is_determined(fit, k) for k in (0, 1)] == [True, False]
    findings = tuple(Finding(k, 0.0, 0.5, ()) for k in (0, 1))
    kept = without_undetermined(Selection(fit, findings), alone, parts)
    assert [placed.effect.id for placed in kept.fit.candidate.effects] == ['friction']
    assert [found.index for found in kept.findings] == [0]
