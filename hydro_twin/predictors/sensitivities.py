"""Runs with their derivatives by parameters, timing and the initial state.

Free runs are those of the kernel, to the last digit. With output feedback, each sample moves the
state toward what was measured before the next step.
"""
from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled, inlined
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.predictors.law_derivatives import BEFORE
from hydro_twin.predictors.rows import add, copy, in_rows, WIDTH
from hydro_twin.predictors.step_derivatives import (
    advance,
    divided,
    output,
    partials,
    read_sensor,
    rows_for,
)
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import Directions, lasting, split_rows, Tangent

UNBOUNDED = 1e50        # of a derivative: its products in a fit would overflow


class OutputFeedback(NamedTuple):
    """What a run with output feedback needs, as an observer with a constant gain.

    Attributes:
        measured: the output, nan where there is none, (N,).
        gain: by how much each state rises for an output measured one above the predicted, (n,);
            empty: the run is free.
    """

    measured: FloatArray
    gain: FloatArray


FREE = OutputFeedback(np.zeros(0), np.zeros(0))


@compiled
def run_stretches(  # type: ignore[no-untyped-def]
        step, tangent, x, z, template, work, blocks, g, inputs, sensors, y, dy, stretches,
        feedback):
    """Fill y (N, 1 + K) with output and sensors, dy (N, 1 + K, D) with their derivatives.

    Each row of stretches (R, 5) holds a part, where it begins and ends in the arrays, the first
    sample of the stretch within the part, and the one after its last. `sensors` are rows of H,
    (K,). x (P, n) and z (P, memory) of the parts are updated in place. Derivatives start from the
    template at the start of a part. After a divergence, the rest of the part is nan, and its
    derivatives are 0.
    """
    n, W, m = x.shape[1], z.shape[1], len(step.shift)
    tangent = split_rows(step, tangent)
    rows = divided(blocks[:n], blocks[n:n + W], blocks[n + W:], m, step.H.shape[1] - n - m)
    for r in range(len(stretches)):
        part, begin, end = stretches[r, 0], stretches[r, 1], stretches[r, 2]
        first, last = stretches[r, 3], stretches[r, 4]
        given, state, memory = inputs[begin:end], x[part], z[part]
        if first == 0:
            copy(blocks, template, n + W)
        elif y[begin + first - 1, 0] != y[begin + first - 1, 0]:
            continue
        for k in range(first, last):
            at = begin + k
            if k > 0:
                advance(step, tangent, state, memory, work, rows, g, given, k)
            y[at, 0] = output(step, tangent, state, memory, work, rows, g, given, k,
                              len(sensors) > 0, dy[at, 0])
            if not abs(y[at, 0]) < LIMIT:
                y[at:end] = float('nan')
                dy[at:end] = 0.0
                break
            for q in range(len(sensors)):
                y[at, 1 + q] = read_sensor(step, tangent, sensors[q], state, memory, work, rows,
                                           dy[at, 1 + q])
            if len(feedback.gain) > 0 and feedback.measured[at] == feedback.measured[at]:
                correct(state, rows, feedback.gain, feedback.measured[at] - y[at, 0], dy[at, 0])


@inlined
def correct(x, rows, gain, innovation, dy):  # type: ignore[no-untyped-def]
    """Move a state by its gain for an innovation, and its derivatives by that of the output."""
    for q in range(len(dy)):
        rows.spare[BEFORE, q // WIDTH, q % WIDTH] = dy[q]
    for i in range(len(x)):
        x[i] += gain[i] * innovation
        add(rows.X, i, -gain[i], rows.spare, BEFORE)


@compiled
def bound(dy, edges, limit):  # type: ignore[no-untyped-def]
    """Zero, in each part, the columns of dy (N, 1 + K, D) that reach the limit anywhere."""
    for part in range(len(edges) - 1):
        begin, end = edges[part], edges[part + 1]
        beyond = False
        for k in range(begin, end):
            for q in range(dy.shape[1]):
                for column in range(dy.shape[2]):
                    if not abs(dy[k, q, column]) < limit:
                        beyond = True
        if not beyond:
            continue
        for column in range(dy.shape[2]):
            grows = False
            for k in range(begin, end):
                for q in range(dy.shape[1]):
                    if not abs(dy[k, q, column]) < limit:
                        grows = True
            if grows:
                for k in range(begin, end):
                    for q in range(dy.shape[1]):
                        dy[k, q, column] = 0.0


def start_rows(system: System, count: int) -> FloatArray:
    """Lay out the derivatives of state and memory at a start as rows, see `in_rows`.

    By so many unknowns, which do not move it, by the state, and by the memory that lasts.
    """
    n, kept = len(system.laws.A), lasting(system)
    columns = np.zeros((n + system.memory, count + n + len(kept)))
    columns[:n, count:count + n] = np.eye(n)
    columns[n + kept, count + n:] = np.eye(len(kept))
    return in_rows(columns)


def run_with_sensitivities(
    system: System, by: Directions, tangents: Sequence[Tangent], inputs: FloatArray,
    edges: IntArray, x: FloatArray, z: FloatArray, starts: Sequence[int | None] = (),
    sensors: Sequence[str] = (), feedback: OutputFeedback = FREE,
) -> tuple[FloatArray, FloatArray]:
    """Run over P parts that follow one another, with derivatives.

    Args:
        system: what is run.
        by: the unknowns.
        tangents: of each of its stages by these and by the initial state, see `tangent_of`.
        inputs: of all parts, (N, m).
        edges: where each part begins there, and where the last one ends, (P + 1,).
        x: their initial states, (P, n).
        z: what the effects keep there, (P, memory).
        starts: stamp of the first sample of each [ns]; None, or none at all, stands for now.
        sensors: names of K that are wanted beside the output.
        feedback: of the output; by default the run is free.

    Returns:
        Output and sensors, (N, 1 + K), and their derivatives, (N, 1 + K, D): by the unknowns, by x
        and by z of the part. Zero for what does not last, and for what grows without bound, as
        under laws that are not stable.
    """
    n, kept, read = x.shape[1], lasting(system), system.sensor_rows(sensors)
    template = start_rows(system, by.count)
    y, dy = np.empty((len(inputs), 1 + len(read))), np.empty(
        (len(inputs), 1 + len(read), by.count + n + len(kept)))
    states, memories = x.copy(), z.copy()
    blocks, g, work = rows_for(system, template.shape[1]), partials(system), system.work()
    stages = system.stages
    for k, stretches in system.stretches_of(edges, starts):
        run_stretches(stages[k].step, tangents[k], states, memories, template, work, blocks, g,
                      inputs, read, y, dy, stretches, feedback)
    bound(dy, edges, UNBOUNDED)
    if len(kept) < system.memory:
        slopes = np.zeros((*dy.shape[:2], by.count + n + system.memory))
        slopes[..., :by.count + n] = dy[..., :by.count + n]
        slopes[..., by.count + n + kept] = dy[..., by.count + n:]
        dy = slopes
    return y, dy
