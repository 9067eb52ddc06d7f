"""A search from several models where the best first effect imitates two others."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.effects import EFFECTS
from hydro_twin.fitting.parts import Part
from hydro_twin.inference import screen
from hydro_twin.inference.beam import beam_search
from hydro_twin.inference.context import Context
from hydro_twin.inference.findings import finding, Selection
from hydro_twin.inference.search import search
from hydro_twin.inference.select import fit_alternatives
from hydro_twin.inference.stepwise import is_residual_structured
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named

PLANT, T, NOISE = plant_named('cylinder'), 0.05, 2e-4
BIAS = place('bias', 'command', {'offset': 0.4}, PLANT)
ZONE = place('dead_zone', 'command', {'width': 0.6, 'centre': -0.3}, PLANT)
LIMIT = place('saturation', 'spool', {'lower': -2.0, 'upper': 2.0}, PLANT)


def moved(seed, *effects):
    """Move a cylinder by random steps of the command."""
    rng = np.random.default_rng(seed)
    values = PLANT.constant_values() | {'K_v': 0.02, 'tau': 0.1}
    command = np.repeat(rng.uniform(-4.0, 4.0, 60), 10)[:, None]
    x = Model(PLANT, values, T, effects).system.run(command, np.zeros(PLANT.order))
    return Part(command, x + NOISE * rng.standard_normal(len(x)))


def searched(*effects):
    """Fit the linear plant and one with an offset to two recordings, and hold out a third."""
    train, held_out = ([moved(seed, *effects).cut(k, k + 200, T) for seed in seeds
                        for k in range(0, 600, 200)] for seeds in ((1, 2), (3,)))
    context = Context(train, held_out, (0.0, 60.0), 0, lambda _: None)
    values = PLANT.constant_values() | {'K_v': 0.01, 'tau': 0.1}
    base = search(Model(PLANT, values, T, substeps=2), train, 40)
    biased = search(Model(PLANT, base.candidate.values, T, (BIAS,), substeps=2), train, 40)
    return base, Selection(biased, (finding(base, biased, (), 0),)), context


def first(base, context):
    """Fit each of the effects."""
    return fit_alternatives(base, context.parts, context.times, 8, afresh=True)


@pytest.fixture(autouse=True)
def few_effects(monkeypatch):
    """Leave the laws that play a part here, to be quick."""
    monkeypatch.setattr(screen, 'EFFECTS', tuple(
        effect for effect in EFFECTS if effect.id in ('bias', 'dead_zone', 'saturation')))


@pytest.mark.slow
def test_a_dead_zone_and_a_limit_are_found_where_an_offset_was():
    base, offset, context = searched(ZONE, LIMIT)
    assert is_residual_structured(offset, context)
    found = beam_search(offset, base, first(base, context), context)
    assert sorted(p.effect.id for p in found.fit.candidate.effects) == ['dead_zone', 'saturation']
    assert len(found.findings) == 2
    assert found.fit.error < 1.25 * NOISE < 0.1 * offset.fit.error


@pytest.mark.slow
def test_what_leaves_nothing_stays_as_it_is():
    base, offset, context = searched(BIAS)
    assert beam_search(offset, base, first(base, context), context) is offset
