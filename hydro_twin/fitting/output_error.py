"""The free runs of a model over parts, from the states that show there, and their errors."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.beginnings import Beginnings, find_starts
from hydro_twin.fitting.parts import edges_of, Part
from hydro_twin.fitting.start import eliminate_starts, Eliminated, Starts, without_starts
from hydro_twin.model import Model
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.sensitivities import run_parts_with_slopes
from hydro_twin.predictors.tangents import NONE, tangents_of

DIVERGED = 1e30         # error of a sample after a run has diverged: more than any that has not


def initial_states(model: Model, parts: Sequence[Part], near: Starts | None = None,
                   beginnings: Beginnings | None = None) -> Starts:
    """Find the state at the start of each part that its first samples show.

    Args:
        model: that is run.
        parts: over which.
        near: starts of a model that differs little, which are searched anew where they miss much.
        beginnings: the first samples, if they are at hand.
    """
    system = model.system
    if beginnings is None:
        beginnings = Beginnings.of(parts, model.start_up)
    stages = np.array([system.stage_at(part.start) for part in parts])
    first, *others = np.unique(stages).tolist()
    if not others:
        return find_starts(system.stages[first], beginnings, near)
    n, memory = len(system.laws.A), system.memory
    found = Starts(np.empty((len(parts), n)), np.empty((len(parts), memory)),
                   np.empty((len(parts), memory, 2)), np.empty(len(parts)))
    for stage in (first, *others):
        here = np.flatnonzero(stages == stage)
        found = found.with_others(here, find_starts(
            system.stages[stage], beginnings.at(here), near and near.at(here)))
    return found


def usual_response(model: Model) -> FloatArray:
    """RMS of the output's response to the state at the start, linear laws, (n,)."""
    response: FloatArray = np.sqrt(np.mean(
        model.system.free_response(model.start_up)**2, axis=0))
    return response


def free_run(model: Model, part: Part, seen: FloatArray | None = None) -> FloatArray:
    """Run freely over a part, from the state that its first samples show; (N,).

    What passes at the ports is written to `seen`, see `System.run`.
    """
    start = initial_states(model, [part])
    return model.system.run(part.inputs, start.x[0], start.z[0], seen, part.start)


def residuals(model: Model, parts: Sequence[Part]) -> list[FloatArray]:
    """Measured less free run over the scored samples of each part, whitened, (N - start-up,)."""
    starts = initial_states(model, parts)
    return [missed[model.start_up:] for missed in _missed(model, parts, starts.x, starts.z)]


def free_run_error(model: Model, parts: Sequence[Part]) -> float:
    """RMS of the residual at the present values, `DIVERGED` where a run diverges."""
    return size_of(residuals(model, parts))


def size_of(missed: Sequence[FloatArray]) -> float:
    """RMS of residuals of parts, a run that diverged being off by `DIVERGED`."""
    return rms(np.nan_to_num(np.concatenate(missed), nan=DIVERGED))


def runs(model: Model, parts: Sequence[Part], x: FloatArray, z: FloatArray | None = None
         ) -> list[FloatArray]:
    """Run freely over each part (N,), from given states (P, n) and what the effects keep there."""
    edges = edges_of(len(part.measured) for part in parts)
    y = model.system.run_parts(np.concatenate([part.inputs for part in parts]), edges, x, z,
                               [part.start for part in parts])
    return np.split(y, edges[1:-1])


def _missed(model: Model, parts: Sequence[Part], x: FloatArray, z: FloatArray | None = None
            ) -> list[FloatArray]:
    """Measured less the runs from given states, whitened, of each part (N,)."""
    return [part.whitened(part.measured - y)
            for part, y in zip(parts, runs(model, parts, x, z), strict=True)]


def fitted_residuals(model: Model, parts: Sequence[Part]) -> list[FloatArray]:
    """Find the residual of each part that is left if the whole of it shows its start.

    See `without_starts`. What is not fitted has only its first samples to go by.
    """
    tangents = tangents_of(model.system, lambda _: NONE)

    def run_from(which: IntArray, starts: Starts, weights: FloatArray | None) -> Eliminated:
        some = [parts[k] for k in which]
        edges = edges_of(len(part.measured) for part in some)
        y, slopes = run_parts_with_slopes(
            model.system, NONE, tangents, np.concatenate([part.inputs for part in some]), edges,
            starts.x, starts.z, [part.start for part in some])
        ran, by_start = (np.split(one[:, 0], edges[1:-1]) for one in (y, slopes))
        return _without_starts(model, [part.whitened(part.measured - one)
                                       for part, one in zip(some, ran, strict=True)],
                               [part.whitened(one)
                                for part, one in zip(some, by_start, strict=True)],
                               weights, starts.room)

    left, _ = eliminate_starts(run_from, initial_states(model, parts))
    return np.split(left.residual, left.edges[1:-1])


def residuals_from(model: Model, parts: Sequence[Part], states: FloatArray) -> list[FloatArray]:
    """Find the residuals of runs from given states, less what others explain by linear laws.

    A quicker `fitted_residuals`, to compare many effects: no start is searched, and what effects
    keep is zero at first.

    Args:
        model: what is run.
        parts: what it is run over.
        states: at the start of each, (P, n).
    """
    response = model.system.free_response(max(len(part.measured) for part in parts))
    left = _without_starts(model, _missed(model, parts, states),
                           [part.whitened(response[:len(part.measured)]) for part in parts])
    return np.split(left.residual, left.edges[1:-1])


def _without_starts(model: Model, missed: Sequence[FloatArray], by_start: Sequence[FloatArray],
                    weights: FloatArray | None = None, room: FloatArray | None = None
                    ) -> Eliminated:
    """Eliminate the states at the starts of parts, see `without_starts`."""
    edges = edges_of(map(len, missed))
    return without_starts(
        np.concatenate(missed), np.concatenate(by_start), usual_response(model),
        np.column_stack([edges[:-1], edges[:-1] + model.start_up, edges[1:]]),
        weights=weights, room=room)
