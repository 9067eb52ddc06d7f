"""What each more sensor makes identifiable: standard errors from the Fisher matrix.

    uv run python -m benchmarks.identifiable

prints the tables of docs/sensors.md. Each plant in the middle of its box runs 10 s of multisines;
output and sensors have white noise of one per cent of their movement, and are sampled at the
plant's sample time. The state at the start is unknown, too. The error of a parameter is that of an
efficient fit (Cramer and Rao); a dash stands for one that no such recording determines by itself.
"""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import get, plant_unknowns
from hydro_twin.model import Model
from hydro_twin.plants import Plant, PLANTS
from hydro_twin.plants.plant import Parameter

DURATION = 10.0         # [s]
NOISE = 0.01            # of the movement: 40 dB
NULL = 1e-8             # of the largest singular value: rounding
BLIND = 0.01            # weight in directions that nothing shows
SHOWN = {               # of the load simulator, some of the sixteen sets
    'load_simulator': [(), ('p_L',), ('x_v',), ('omega_m',), ('p_L', 'x_v'),
                       ('p_L', 'x_v', 'theta_m', 'omega_m')]}
D_M = Parameter('D_m', 'motor displacement', 'm^3/rad', 1e-5, 4e-5, 1e-6, 1e-3)


def recorded(plant: Plant, values: Mapping[str, float], sensors: Sequence[str]) -> Part:
    """Run a plant under multisines, and read its sensors, without noise."""
    T, rng = plant.sample_time, np.random.default_rng(0)
    samples = round(DURATION / T)
    t = T * np.arange(samples)
    inputs = np.column_stack([
        np.sin(2.0 * np.pi * np.outer(t, frequencies) + phases).sum(axis=1)
        for frequencies, phases in (
            (rng.uniform(0.1, 30.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12))
            for _ in plant.inputs)])
    # Inputs that move the output about as far each, so that none is hidden by another.
    system = Model(plant, values, T).system
    x = np.zeros(plant.order)
    for column in range(len(plant.inputs)):
        alone = np.where(np.arange(len(plant.inputs)) == column, inputs, 0.0)
        inputs[:, column] *= plant.output_scale / np.std(system.run(alone, x))
    seen = np.empty((samples, len(system.step.H)))
    y = system.run(inputs, x, seen=seen)
    return Part(inputs, y, sensors=dict(zip(
        sensors, seen[:, system.sensor_rows(sensors)].T, strict=True)))


def errors(plant: Plant, values: Mapping[str, float], sensors: Sequence[str]
           ) -> dict[str, float | None]:
    """Relative standard error of each parameter and combination; None: not determined."""
    part = recorded(plant, values, sensors)
    problem = Problem(Model(plant, values, plant.sample_time), plant_unknowns(plant, 'box'),
                      [part])
    at = np.array([u.coordinate(get(problem.base, u)) for u in problem.unknowns])
    scales = 1.0 / (NOISE * problem.pieces.sizes)
    jacobian = problem.at(at, weights=np.ones(1), scales=scales).jacobian
    if not sensors:
        jacobian = jacobian * scales[0]             # one output has no scale
    names = [unknown.name for unknown in problem.unknowns]
    _, singular, Vt = np.linalg.svd(np.linalg.qr(jacobian)[1])
    known = singular > NULL * singular[0]

    def error(direction: FloatArray) -> float | None:
        if np.linalg.norm(Vt[~known] @ direction) > BLIND * np.linalg.norm(direction):
            return None
        return float(np.linalg.norm((Vt[known] @ direction) / singular[known]))

    unit = np.eye(len(names))
    found = {name: error(unit[k]) for k, name in enumerate(names)}
    for combination in plant.combinations:
        label = ''.join(f'{"" if k == 0 else " " if power > 0 else " / "}{name}'
                        for k, (name, power) in enumerate(combination.items()))
        found[label] = error(sum(power * unit[names.index(name)]
                                 for name, power in combination.items()) + 0.0 * unit[0])
    return found


def table(plant: Plant, values: Mapping[str, float], sets: Sequence[tuple[str, ...]]) -> str:
    """Lay out the errors [%] of each parameter (rows) by what is measured (columns)."""
    columns = [errors(plant, values, sensors) for sensors in sets]
    heads = [plant.output.name, *(f'+ {", ".join(sensors)}' for sensors in sets if sensors)]
    lines = [f'| {plant.name} | {" | ".join(heads)} |', f'|---|{"---|" * len(heads)}']
    for name in columns[0]:
        cells = ['–' if (e := column[name]) is None else f'{100 * e:.2g}' for column in columns]
        lines.append(f'| {name} | {" | ".join(cells)} |')
    return '\n'.join(lines)


def with_sensors() -> Iterator[tuple[Plant, dict[str, float], Sequence[tuple[str, ...]]]]:
    """Yield each plant with sensors, the middle of its box, and the sets of sensors to show."""
    for plant in PLANTS.values():
        every = [sensor.name for sensor in plant.sensors]
        if every:
            yield plant, {**plant.constant_values(), **plant.middle()}, SHOWN.get(plant.name) or [
                some for count in range(len(every) + 1) for some in combinations(every, count)]


def main() -> None:
    """Print a table for each plant with sensors, and one of the load simulator without D_m."""
    for plant, values, sets in with_sensors():
        print(f'\n{table(plant, values, sets)}')
    plant = PLANTS['load_simulator']
    unsure = replace(plant, parameters=(*plant.parameters, D_M), constants=())
    values = {**plant.constant_values(), **plant.middle()}
    print(f'\nD_m unknown\n\n{table(unsure, values, SHOWN[plant.name])}')


if __name__ == '__main__':
    main()
