"""What an observer shows: the states of the plant, and what its effects keep, by name."""
from __future__ import annotations

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.effects.effect import ADDED
from hydro_twin.predictors.system import System


def quantities_of(system: System, width: int) -> tuple[tuple[str, ...], FloatArray]:
    """Name what can be shown of a system, and give it as sums of what is known.

    Args:
        system: what is run.
        width: how many states, memory and parameters there are.

    Returns:
        R names, PORT_EFFECT_QUANTITY for those of an effect, and weights of states, memory and
        parameters, then of inputs and what effects add to the ports, (R, width + m + P).
    """
    step, plant = system.step, system.plant
    n, columns = len(system.laws.A), step.H.shape[1]
    names, rows = list(plant.states), list(np.eye(n, width + columns - n))
    beside = np.ones(columns)               # d of a port without effects is never written
    beside[columns - len(plant.ports):] = 0.0
    beside[columns - len(plant.ports) + step.active] = 1.0
    for e, (placed, entry) in enumerate(zip(system.placed, step.effects, strict=True)):
        for quantity in placed.effect.shows:
            row = np.zeros(width + columns - n)
            for what, weight in quantity.weights(placed.values).items():
                if what == ADDED:
                    row[n + system.memory - len(step.effects) + e] += weight
                elif isinstance(what, int):
                    row[n + entry['z_begin'] + what] += weight
                else:
                    seen = weight * beside * step.H[plant.signal_row(placed.port, what)]
                    row[:n] += seen[:n]
                    row[width:] += seen[n:]
            name = f'{placed.port.name}_{placed.effect.id}_{quantity.name}'
            names.append(name if name not in names else f'{name}_{e}')
            rows.append(row)
    return tuple(names), np.array(rows)
