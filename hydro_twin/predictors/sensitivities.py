"""A free run with its derivatives: by parameters, timing, and the state at its start.

The run is that of the kernel, to the last digit.
"""
from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from hydro_twin.compiled import compiled
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.predictors.rows import in_rows
from hydro_twin.predictors.step_derivatives import (
    advance,
    output,
    partials,
    read_sensor,
    rows_for,
)
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import Directions, lasting, Tangent

UNBOUNDED = 1e50        # of a derivative: its products in a fit would overflow


@compiled
def run(  # type: ignore[no-untyped-def]
        step, tangent, x, z, work, rows, g, inputs, sensors, y, dy, first, last):
    """Fill y (1 + K, N) with output and sensors, dy (1 + K, N, D) with their derivatives.

    At first <= k < last; `sensors` are rows of H, (K,). x, z and rows are those of the sample
    before the first, and are moved. A run that diverges is left at nan from there on, its
    derivatives at 0.
    """
    for k in range(first, last):
        if k > 0:
            advance(step, tangent, x, z, work, rows, g, inputs, k)
        y[0, k] = output(step, tangent, x, z, work, rows, g, inputs, k, dy[0, k])
        if not abs(y[0, k]) < LIMIT:
            y[:, k:] = float('nan')
            dy[:, k:] = 0.0
            return
        for q in range(len(sensors)):
            y[1 + q, k] = read_sensor(step, tangent, sensors[q], x, z, work, rows, dy[1 + q, k])


def run_with_slopes(system: System, by: Directions, tangents: Sequence[Tangent],
                    inputs: FloatArray, x: FloatArray, z: FloatArray, start: int | None = None
                    ) -> tuple[FloatArray, FloatArray]:
    """Run freely as `run_all_with_slopes`; returns the output (N,) and its derivatives (N, D)."""
    y, slopes = run_all_with_slopes(system, by, tangents, inputs, x, z, start)
    return y[0], slopes[0]


def run_all_with_slopes(
    system: System, by: Directions, tangents: Sequence[Tangent], inputs: FloatArray,
    x: FloatArray, z: FloatArray, start: int | None = None, sensors: Sequence[str] = (),
) -> tuple[FloatArray, FloatArray]:
    """Run freely from state x (n,) and memory z, with derivatives.

    Args:
        system: what is run.
        by: the unknowns.
        tangents: of each of its stages by these and by the state at the start, see `tangent_of`.
        inputs: (N, m).
        x: the state at the start, (n,).
        z: what the effects keep there, (memory,).
        start: stamp of the first sample [ns]; None stands for now.
        sensors: names of K that are wanted beside the output.

    Returns:
        Output and sensors, (1 + K, N), and their derivatives, (1 + K, N, D): by the unknowns, by x
        and by z. Zero for what does not last, and for what grows without bound, as under laws
        that are not stable.
    """
    n, kept = len(x), lasting(system)
    columns = np.zeros((n + system.memory, by.count + n + len(kept)))
    columns[:n, by.count:by.count + n] = np.eye(n)
    columns[n + kept, by.count + n:] = np.eye(len(kept))
    blocks = in_rows(columns)
    rows = rows_for(system, blocks.shape[1])
    rows.X[:], rows.Z[:] = blocks[:n], blocks[n:]
    g = partials(system)
    outputs, N = 1 + len(sensors), len(inputs)
    y, dy = np.empty((outputs, N)), np.empty((outputs, N, columns.shape[1]))
    x, z, stages, read = x.copy(), z.copy(), system.stages, system.sensor_rows(sensors)
    for k, first, last in system.stretches(len(inputs), start):
        run(stages[k].step, tangents[k], x, z, system.work(), rows, g, inputs, read, y, dy, first,
            last)
        if math.isnan(y[0, last - 1]):
            break
    dy[..., ~(np.abs(dy).max(axis=(0, 1)) < UNBOUNDED)] = 0.0
    if len(kept) == system.memory:
        return y, dy
    slopes = np.zeros((outputs, N, by.count + n + system.memory))
    slopes[..., :by.count + n] = dy[..., :by.count + n]
    slopes[..., by.count + n + kept] = dy[..., by.count + n:]
    return y, slopes
