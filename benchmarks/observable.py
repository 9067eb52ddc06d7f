"""What each more sensor tells the observer: how well it knows the states.

    uv run python -m benchmarks.observable

prints the tables of docs/sensors.md. Each plant is in the middle of its box, under the multisines
of `benchmarks.identifiable`; output and sensors have white noise of one per cent of their movement
and are sampled at the plant's sample time. Noise of five per cent of the movement of the commands,
which nobody records, disturbs it. The deviation is that after a measurement, once it has settled.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math

import numpy as np

from benchmarks.identifiable import NOISE, recorded, with_sensors
from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.noise import states
from hydro_twin.model import Model, Noise
from hydro_twin.plants import Plant
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.recording.series import Series

DISTURBANCE = 0.05      # of the movement of a command


def deviations(plant: Plant, values: Mapping[str, float], sensors: Sequence[str]) -> FloatArray:
    """Return the standard deviation of each state, over that of its movement, (n,)."""
    part = recorded(plant, values, [sensor.name for sensor in plant.sensors])
    series = Series({**dict(zip((signal.name for signal in plant.inputs), part.inputs.T,
                                strict=True)), plant.output.name: part.measured, **part.sensors},
                    plant.sample_time)
    model = Model(plant, values, plant.sample_time)
    movement = states(Analytical(model), series).std(axis=0)
    held = [signal.held for signal in plant.inputs]
    unknown = DISTURBANCE * part.inputs.std(axis=0)[held]
    process = math.sqrt(plant.sample_time) * np.linalg.norm(
        model.system.laws.B[:, held] * unknown, axis=1)
    noise = Noise(
        NOISE * float(np.std(part.measured)), dict(zip(plant.states, process, strict=True)),
        dict(zip(plant.states, movement, strict=True)),
        sensors={name: NOISE * float(np.std(part.sensors[name])) for name in sensors})
    _, estimates = Analytical(replace(model, noise=noise)).observed(series)
    settled: FloatArray = estimates[-1, 1, :plant.order] / movement
    return settled


def main() -> None:
    """Print a table for each plant with sensors: states in rows, what is measured in columns."""
    for plant, values, sets in with_sensors():
        heads = [plant.output.name, *(f'+ {", ".join(some)}' for some in sets if some)]
        columns = [deviations(plant, values, some) for some in sets]
        print(f'\n| {plant.name} | {" | ".join(heads)} |\n|---|{"---|" * len(heads)}')
        for k, name in enumerate(plant.states):
            cells = ' | '.join(f'{100 * column[k]:.2g}' for column in columns)
            print(f'| {name} | {cells} |')


if __name__ == '__main__':
    main()
