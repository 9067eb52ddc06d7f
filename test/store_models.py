"""Model files for the tests of the store."""
from __future__ import annotations

from hydro_twin.model import Model, place, Record, Uncertainty, write_model
from hydro_twin.plants import plant_named

PLANT = plant_named('load_simulator')


def model(effects=(), plant=PLANT, **changes):
    """Make a model; effects as (id, port, {name: (value, error)}), changes as (value, error)."""
    found = {p.name: changes.get(p.name, ((p.lower * p.upper)**0.5, None))
             for p in plant.parameters}
    placed = tuple(place(name, port, {key: one for key, (one, _) in values.items()}, plant)
                   for name, port, values in effects)
    errors = {name: error for name, (_, error) in found.items()}
    errors |= {f'{k}:{key}': error for k, (_, _, values) in enumerate(effects)
               for key, (_, error) in values.items()}
    return Model(plant, plant.constant_values() | {name: one for name, (one, _) in found.items()},
                 plant.sample_time, placed, record=Record(
                     {name: Uncertainty(std_error=error) for name, error in errors.items()}))


def write(path, *args, **changes):
    """Write one to a file; returns its path."""
    write_model(model(*args, **changes), path)
    return path
