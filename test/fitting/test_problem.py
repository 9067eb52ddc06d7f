"""The search: what its first step promises, and where it ends."""
from dataclasses import replace

import numpy as np
import pytest

from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import CONVERGED, Problem
from hydro_twin.fitting.unknowns import effect_unknowns, plant_unknowns
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named

PLANT = plant_named('valve_servo')
VALUES = {**PLANT.constant_values(), **PLANT.middle()}


def moved(*effects):
    """Make a model with effects, and a recording of it without noise."""
    t = PLANT.sample_time * np.arange(1500)
    command = 0.5 + 0.3 * np.sin(2 * np.pi * 1.1 * t) * np.sin(2 * np.pi * 0.3 * t)
    model = Model(PLANT, VALUES, PLANT.sample_time, tuple(
        place(*effect, PLANT) for effect in effects))
    system = model.system
    x = system.start(command[:1], command[0])
    return model, Part(command[:, None], system.run(command[:, None], x))


def changed(model, index, **values):
    """Set parameters of one of the effects of a model."""
    placed = model.effects[index]
    other = place(placed.effect.id, placed.port.name, placed.named | values, PLANT)
    return replace(model, effects=(*model.effects[:index], other, *model.effects[index + 1:]))


def test_what_enters_linearly_is_predicted_exactly():
    """A bias of the sensor: the first step leaves what the whole search does."""
    model, part = moved(('bias', 'sensor', {'offset': 0.02}))
    problem = Problem(changed(model, 0, offset=0.0), effect_unknowns(0, model.effects[0]), [part])
    here, leaves = problem.linear_prediction()
    assert leaves < 1e-3 * here.sum_of_squares
    found = problem.search(40, 1e-9)
    assert leaves == pytest.approx(found.sum_of_squares, abs=1e-6 * here.sum_of_squares)


def test_a_step_promises_no_more_than_its_bounds_allow():
    model, part = moved(('dead_zone', 'command', {'width': 0.05}))
    problem = Problem(changed(model, 0, width=1e-6), effect_unknowns(0, model.effects[0])[:1],
                      [part])
    here, leaves = problem.linear_prediction()
    before = here.sum_of_squares
    assert 0.9 * before < leaves <= before      # a factor of e makes it 3e-6


def test_a_search_ends_where_no_step_is_better(monkeypatch):
    """At the kinks of a wrong law the derivatives promise what no step keeps."""
    _, part = moved(('backlash', 'stem', {'gap': 0.02}))
    noise = 0.001 * np.random.default_rng(0).standard_normal(len(part.measured))
    part = replace(part, measured=part.measured + noise)
    wrong, _ = moved(('dead_zone', 'command', {'width': 0.01}))
    unknowns = [*plant_unknowns(PLANT, 'physical'), *effect_unknowns(0, wrong.effects[0])]
    runs, at = [], Problem.at

    def counted(*args, **more):
        runs.append(None)
        return at(*args, **more)

    monkeypatch.setattr(Problem, 'at', counted)

    def found():
        runs.clear()
        search = Problem(replace(wrong, substeps=2), unknowns, [part]).search(200, 1e-6)
        assert search.reason == CONVERGED
        return search.sum_of_squares, len(runs)

    power, count = found()
    monkeypatch.setattr('hydro_twin.fitting.problem.PATIENCE', 10**9)
    to_the_end, more = found()
    assert count < more
    assert power == pytest.approx(to_the_end, rel=1e-3)
