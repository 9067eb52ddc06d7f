"""The search for initial states, compiled: of one part after another, by its first samples.

Levenberg's method [Levenberg 1944], by the derivatives of the whole model. A state is that of the
plant and the memory of the effects, c coordinates, of which some are free in a search.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled
from hydro_twin.fitting.cholesky import solve_cholesky
from hydro_twin.predictors.kernel import run, Step
from hydro_twin.predictors.sensitivities import (
    bound,
    FREE,
    OutputFeedback,
    run_stretches,
    start_rows,
    UNBOUNDED,
)
from hydro_twin.predictors.step_derivatives import partials, rows_for
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import lasting, Tangent

HALVED = 0.5            # of the sum of squares: more is left where a search failed
LOWERED = 0.9           # of the sum of squares: more is left by the last step of a search
NEAR = 0.05             # of the movement: an RMS residual below it is that of the right branch
STEPS = 8               # of a search
SHORTEST = 4            # samples for each state: fewer are not searched by themselves
RIDGE = 0.01            # cost of a deviation from rest, over that of as large an output
RIDGES = (RIDGE, 0.3, 10.0)     # of the steps of a search, tried in this order
SINGULAR = 1e-12        # of the trace of normal equations, added to their diagonal


class Runs(NamedTuple):
    """What runs over the first samples need, with and without derivatives by c coordinates.

    Attributes:
        step: of the system.
        tangent: of that by the initial state alone.
        template: derivatives at the start, see `run_stretches`.
        columns: which coordinate each derivative is by, (D,).
        work, blocks, partials, x, z, y, slopes, stretch, sensors, seen: scratch.
        feedback: none.
    """

    step: Step
    tangent: Tangent
    template: FloatArray
    columns: IntArray
    work: FloatArray
    blocks: FloatArray
    partials: FloatArray
    x: FloatArray
    z: FloatArray
    y: FloatArray
    slopes: FloatArray
    stretch: IntArray
    sensors: IntArray
    seen: FloatArray
    feedback: OutputFeedback


class First(NamedTuple):
    """The first samples of P parts, and the coordinates of their states.

    Attributes:
        inputs: (P, N, m).
        measured: the output, (P, N).
        counts: samples of each part, (P,).
        sizes: movement of the output of each, (P,).
        rest: states at rest, (P, c).
        scale: how far each coordinate goes to move the output by its size, (P, c); 0: it is held.
        edges: between which the memory is, (P, memory, 2).
        linear: derivatives of the output by the laws without effects, (N, c).
        free: which coordinates are searched at first, (c,).
        every: all of them, (c,).
    """

    inputs: FloatArray
    measured: FloatArray
    counts: IntArray
    sizes: FloatArray
    rest: FloatArray
    scale: FloatArray
    edges: FloatArray
    linear: FloatArray
    free: npt.NDArray[np.bool_]
    every: npt.NDArray[np.bool_]


class Descent(NamedTuple):
    """Where the search of a part is: its state (c,), residual (N,) and Jacobian (N, c).

    And scratch: the same of a trial, states to go back to, normal equations, and a step.
    """

    state: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    trial: FloatArray
    trial_residual: FloatArray
    before: FloatArray
    residual_before: FloatArray
    best: FloatArray
    normal: FloatArray
    step: FloatArray


def runs_of(system: System, tangent: Tangent, samples: int) -> Runs:
    """Allocate what runs of a system over so many samples need; for the tangent see `Runs`."""
    n, kept = len(system.laws.A), lasting(system)
    columns = np.concatenate([np.arange(n), n + kept])
    template = start_rows(system, 0)
    return Runs(
        system.step, tangent, template, columns, system.work(),
        rows_for(system, template.shape[1]), partials(system), np.empty((1, n)),
        np.empty((1, system.memory)), np.empty((samples, 1)),
        np.empty((samples, 1, len(columns))), np.zeros((1, 5), dtype=np.int64),
        system.sensor_rows(()), np.empty((0, 0)), FREE)


def room_for(samples: int, c: int) -> Descent:
    """Allocate a search over so many samples, at most, by c coordinates."""
    return Descent(*(np.empty(shape) for shape in (
        c, samples, (samples, c), c, samples, c, samples, c, (c, c), (c, 1))))


@compiled
def search_each(runs, first, at, parts, states, afresh):  # type: ignore[no-untyped-def]
    """Search the states (K, c) of some parts in place: by `search`, or from there alone."""
    for k in range(len(parts)):
        part = parts[k]
        if afresh:
            search(runs, first, at, part)
        else:
            copy(at.state, states[k])
            descend(runs, first, at, part, first.counts[part], first.free)
        copy(states[k], at.state)


@compiled
def search(runs, first, at, part):  # type: ignore[no-untyped-def]
    """Search the state of a part from rest, and where that fits poorly from others, too.

    Where a mass reverses, its friction changes sign: no step leads there from a state from
    which it reverses at another time. With the samples before that, the search is easy. A gap
    may be entered from either side, and a search from one does not reach the other; nor does
    the output determine the memory of a play inside its gap.
    """
    count = first.counts[part]
    copy(at.state, first.rest[part])
    if len(runs.step.effects) == 0:
        squares = start(runs, first, at, part, count)
        step(runs, first, at, part, count, squares, RIDGE, 1.0)
        return
    squares = descend(runs, first, at, part, count, first.free)
    if is_poor(first, part, squares, count):
        squares = from_fewer_samples(runs, first, at, part, squares)
        if is_poor(first, part, squares, count):
            from_other_branches(runs, first, at, part, squares)


@compiled
def is_poor(first, part, squares, count):  # type: ignore[no-untyped-def]
    """Whether a sum of squares over so many samples is large."""
    return squares > (NEAR * first.sizes[part])**2 * count


@compiled
def halved(count, times):  # type: ignore[no-untyped-def]
    """Halve a count so many times, rounded up."""
    for _ in range(times):
        count = (count + 1) // 2
    return count


@compiled
def from_fewer_samples(runs, first, at, part, squares):  # type: ignore[no-untyped-def]
    """Search by half of the samples, if need be by half of those, and so on.

    Then from the state found by twice as many, up to all of them. The result is taken where it
    lowers the sum of squares, which is returned.
    """
    whole, depth, poor = first.counts[part], 0, True
    copy(at.before, at.state)
    copy(at.residual_before, at.residual)
    while poor and halved(whole, depth + 1) >= SHORTEST * runs.x.shape[1]:
        depth += 1
        count = halved(whole, depth)
        copy(at.state, first.rest[part])
        poor = is_poor(first, part, descend(runs, first, at, part, count, first.free), count)
    found = squares
    for fewer in range(depth - 1, -1, -1):
        found = descend(runs, first, at, part, halved(whole, fewer), first.free)
    if found < squares:
        return found
    copy(at.state, at.before)
    copy(at.residual, at.residual_before)
    return squares


@compiled
def from_other_branches(runs, first, at, part, squares):  # type: ignore[no-untyped-def]
    """Search from states on other sides of a gap, the memory being a coordinate, too.

    One step leads from each of these states, by the derivatives at hand, and a search from
    the best, which is taken if it lowers the sum of squares by much.
    """
    n, count, scale, best = runs.x.shape[1], first.counts[part], first.scale[part], np.inf
    for i in range(len(scale)):
        for side in range(2 if first.free[i] else 3):
            if scale[i] == 0.0:
                continue
            copy(at.trial, at.state)
            if first.free[i]:
                at.trial[i] += scale[i] if side else -scale[i]
            else:
                low, high = first.edges[part, i - n, 0], first.edges[part, i - n, 1]
                at.trial[i] = 0.5 * (low + high) if side == 2 else high if side else low
            misfit(runs, first, part, at.trial, count, at.trial_residual)
            regress(at.jacobian, at.trial_residual, count, (RIDGE * first.sizes[part])**2,
                    at.normal, at.step)
            for j in range(len(scale)):
                at.trial[j] += scale[j] * at.step[j, 0]
            left = misfit(runs, first, part, at.trial, count, at.trial_residual)
            if left < best:
                best = left
                copy(at.best, at.trial)
    if not best < LOWERED * squares:
        return
    copy(at.before, at.state)
    copy(at.state, at.best)
    if not descend(runs, first, at, part, count, first.every) < HALVED * squares:
        copy(at.state, at.before)


@compiled
def descend(runs, first, at, part, count, free):  # type: ignore[no-untyped-def]
    """Search by so many samples along the free coordinates (c,); returns the sum of squares.

    Leaves the Jacobian before the last step.
    """
    squares = start(runs, first, at, part, count)
    # What sticks at rest has no derivative there: first by the linear laws, if it moves.
    squares = step(runs, first, at, part, count, squares, RIDGE, HALVED)
    for _ in range(STEPS):
        differentiate(runs, first, at, part, count, free)
        before = squares
        for ridge in RIDGES:
            squares = step(runs, first, at, part, count, squares, ridge, LOWERED)
            if squares < before:
                break
        if not squares < before:
            break
    return squares


@compiled
def start(runs, first, at, part, count):  # type: ignore[no-untyped-def]
    """Run from the state, with the Jacobian of the linear laws; returns the sum of squares."""
    for i in range(count):
        for a in range(len(at.state)):
            at.jacobian[i, a] = first.linear[i, a] * first.scale[part, a]
    return misfit(runs, first, part, at.state, count, at.residual)


@compiled
def misfit(runs, first, part, state, count, residual):  # type: ignore[no-untyped-def]
    """Fill the residual (N,) of a run from a state over so many samples; returns its squares."""
    n = runs.x.shape[1]
    copy(runs.x[0], state[:n])
    copy(runs.z[0], state[n:])
    run(runs.step, runs.x[0], runs.z[0], runs.work, first.inputs[part], residual[:count],
        runs.seen, 0, count)
    total = 0.0
    for i in range(count):
        residual[i] = first.measured[part, i] - residual[i]
        total += residual[i] * residual[i]
    return total if total < np.inf else np.inf


@compiled
def differentiate(runs, first, at, part, count, free):  # type: ignore[no-untyped-def]
    """Run from the state with derivatives by the free coordinates, (c,)."""
    n = runs.x.shape[1]
    copy(runs.x[0], at.state[:n])
    copy(runs.z[0], at.state[n:])
    runs.stretch[0, 2] = count
    runs.stretch[0, 4] = count
    run_stretches(runs.step, runs.tangent, runs.x, runs.z, runs.template, runs.work, runs.blocks,
                  runs.partials, first.inputs[part], runs.sensors, runs.y, runs.slopes,
                  runs.stretch, runs.feedback)
    bound(runs.slopes, runs.stretch[0, 1:3], UNBOUNDED)
    for i in range(count):
        for a in range(len(at.state)):
            at.jacobian[i, a] = 0.0
        for q in range(len(runs.columns)):
            a = runs.columns[q]
            if free[a]:
                at.jacobian[i, a] = runs.slopes[i, 0, q] * first.scale[part, a]


@compiled
def step(runs, first, at, part, count, squares, ridge, enough):  # type: ignore[no-untyped-def]
    """Step where that lowers the sum of squares to `enough` of it; returns what it then is."""
    left = regress(at.jacobian, at.residual, count, (ridge * first.sizes[part])**2, at.normal,
                   at.step)
    if not left < enough * squares:
        return squares
    for a in range(len(at.state)):
        at.trial[a] = at.state[a] + first.scale[part, a] * at.step[a, 0]
    found = misfit(runs, first, part, at.trial, count, at.trial_residual)
    if not found < enough * squares:
        return squares
    copy(at.state, at.trial)
    copy(at.residual, at.trial_residual)
    return found


@compiled
def copy(to, values):  # type: ignore[no-untyped-def]
    """Copy values (K,)."""
    for i in range(len(values)):
        to[i] = values[i]


@compiled
def regress(jacobian, residual, count, ridge, normal, found):  # type: ignore[no-untyped-def]
    """Regress the first residuals (N,) on the columns of the Jacobian (N, c), with a ridge.

    Fills the coefficients, (c, 1), zero where anything has diverged; returns the sum of squares
    that is left. The normal equations are in normal (c, c).
    """
    c = jacobian.shape[1]
    found[:] = 0.0
    normal[:] = 0.0
    for i in range(count):
        for a in range(c):
            found[a, 0] += jacobian[i, a] * residual[i]
            for b in range(a + 1):
                normal[a, b] += jacobian[i, a] * jacobian[i, b]
    trace, finite = 0.0, True
    for a in range(c):
        trace += normal[a, a]
        finite = finite and abs(found[a, 0]) < np.inf
    if finite and trace < np.inf:
        solve_cholesky(normal, found, max(ridge + SINGULAR * trace, 1e-300))
    else:
        found[:] = 0.0
    squares = 0.0
    for i in range(count):
        rest = residual[i]
        for a in range(c):
            rest -= jacobian[i, a] * found[a, 0]
        squares += rest * rest
    return squares
