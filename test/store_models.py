"""Model files for the tests of the store."""
from __future__ import annotations

from hydro_twin.model import Estimate, FittedEffect, Model, place, write_model
from hydro_twin.plants import plant_named

PLANT = plant_named('load_simulator')


def model(effects=(), plant=PLANT, **changes):
    """Make a model; effects as (id, port, {name: (value, error)}), changes as (value, error)."""
    estimates = {p.name: Estimate(*changes.get(p.name, ((p.lower * p.upper)**0.5, None)))
                 for p in plant.parameters}
    fitted = tuple(
        FittedEffect(place(name, port, {key: one for key, (one, _) in values.items()}, plant),
                     {key: error for key, (_, error) in values.items()})
        for name, port, values in effects)
    return Model(plant, estimates, plant.constant_values(), plant.sample_time, effects=fitted)


def write(path, *args, **changes):
    """Write one to a file; returns its path."""
    write_model(model(*args, **changes), path)
    return path
