"""The free runs of a model over parts, from estimated initial states, and their residuals."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.elimination import eliminate, eliminate_with_reruns, Eliminated
from hydro_twin.fitting.first_samples import FirstSamples
from hydro_twin.fitting.initial_state_search import find_initial_states
from hydro_twin.fitting.initial_states import InitialStates
from hydro_twin.fitting.parts import edges_of, Part
from hydro_twin.model import Model
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.sensitivities import run_with_sensitivities
from hydro_twin.predictors.tangents import NONE, tangents_of

DIVERGED = 1e30         # error of a sample after a run has diverged: more than any that has not


def initial_states(model: Model, parts: Sequence[Part], near: InitialStates | None = None,
                   first: FirstSamples | None = None) -> InitialStates:
    """Estimate the initial state of each part from its first samples.

    Args:
        model: that is run.
        parts: over which.
        near: initial states under a similar model, see `find_initial_states`.
        first: the first samples, if they are at hand.
    """
    system = model.system
    # From near states no search crosses friction or a stop. A state on the wrong side of these is
    # forgotten, unless the plant integrates.
    warm_start = not (model.plant.integrates
                      and any(placed.effect.implicit for placed in model.effects))
    if first is None:
        first = FirstSamples.of(parts, model.start_up)
    stages = np.array([system.stage_at(part.start) for part in parts])
    earliest, *later = np.unique(stages).tolist()
    if not later:
        return find_initial_states(system.stages[earliest], first, near, warm_start)
    n, memory = len(system.laws.A), system.memory
    found = InitialStates(np.empty((len(parts), n)), np.empty((len(parts), memory)),
                          np.empty((len(parts), n + memory, 2)), np.empty(len(parts)))
    for stage in (earliest, *later):
        here = np.flatnonzero(stages == stage)
        found = found.with_others(here, find_initial_states(
            system.stages[stage], first.at(here), near and near.at(here), warm_start))
    return found


def linear_response(model: Model) -> FloatArray:
    """RMS of the output's response to each initial state by the linear laws, (n,)."""
    response: FloatArray = np.sqrt(np.mean(
        model.system.free_response(model.start_up)**2, axis=0))
    return response


def free_run(model: Model, part: Part) -> FloatArray:
    """Run freely over a part from the initial state that its first samples show; (N,)."""
    initial = initial_states(model, [part])
    return model.system.run(part.inputs, initial.x[0], initial.z[0], start=part.start)


def residuals(model: Model, parts: Sequence[Part]) -> list[FloatArray]:
    """Measured minus free run over the scored samples of each part, whitened, (N - start-up,)."""
    initial = initial_states(model, parts)
    return [residual[model.start_up:]
            for residual in _residuals(model, parts, initial.x, initial.z)]


def free_run_error(model: Model, parts: Sequence[Part]) -> float:
    """RMS of the residual at the present values, `DIVERGED` where a run diverges."""
    return size_of(residuals(model, parts))


def size_of(pieces: Sequence[FloatArray]) -> float:
    """RMS of the residuals of parts, a run that diverged being off by `DIVERGED`."""
    return rms(np.nan_to_num(np.concatenate(pieces), nan=DIVERGED))


def runs(model: Model, parts: Sequence[Part], x: FloatArray, z: FloatArray | None = None
         ) -> list[FloatArray]:
    """Run freely over each part (N,), from given states (P, n) and memory of the effects."""
    edges = edges_of(len(part.measured) for part in parts)
    y = model.system.run_parts(np.concatenate([part.inputs for part in parts]), edges, x, z,
                               [part.start for part in parts])
    return np.split(y, edges[1:-1])


def _residuals(model: Model, parts: Sequence[Part], x: FloatArray, z: FloatArray | None = None
               ) -> list[FloatArray]:
    """Measured minus the runs from given states, whitened, of each part (N,)."""
    return [part.whitened(part.measured - y)
            for part, y in zip(parts, runs(model, parts, x, z), strict=True)]


def fitted_residuals(model: Model, parts: Sequence[Part], initial: InitialStates | None = None
                     ) -> list[FloatArray]:
    """Find the residual of each part with its initial state fitted to all of it.

    See `eliminate`. `residuals` estimates it from the first samples alone.

    Args:
        model: that is run.
        parts: over which.
        initial: states near which to fit; None: as estimated from the first samples.
    """
    tangents = tangents_of(model.system, NONE)

    def run_from(which: IntArray, initial: InitialStates, weights: FloatArray | None
                 ) -> Eliminated:
        some = [parts[k] for k in which]
        edges = edges_of(len(part.measured) for part in some)
        y, slopes = run_with_sensitivities(
            model.system, NONE, tangents, np.concatenate([part.inputs for part in some]), edges,
            initial.x, initial.z, [part.start for part in some])
        ran, by_state = (np.split(one[:, 0], edges[1:-1]) for one in (y, slopes))
        return _eliminate(model, [part.whitened(part.measured - one)
                                  for part, one in zip(some, ran, strict=True)],
                          [part.whitened(one)
                           for part, one in zip(some, by_state, strict=True)],
                          weights, initial.margins)

    if initial is None:
        initial = initial_states(model, parts)
    found, _ = eliminate_with_reruns(run_from, initial)
    return np.split(found.residual, found.edges[1:-1])


def residuals_from(model: Model, parts: Sequence[Part], states: FloatArray) -> list[FloatArray]:
    """Find the residuals of runs from given states, corrected for these by the linear laws.

    A quicker `fitted_residuals`, to compare many effects: no initial state is searched, and the
    memory of the effects is zero at first.

    Args:
        model: what is run.
        parts: what it is run over.
        states: at the beginning of each, (P, n).
    """
    response = model.system.free_response(max(len(part.measured) for part in parts))
    found = _eliminate(model, _residuals(model, parts, states),
                       [part.whitened(response[:len(part.measured)]) for part in parts])
    return np.split(found.residual, found.edges[1:-1])


def _eliminate(model: Model, pieces: Sequence[FloatArray], by_state: Sequence[FloatArray],
               weights: FloatArray | None = None, margins: FloatArray | None = None
               ) -> Eliminated:
    """Eliminate the initial states of parts, see `eliminate`."""
    edges = edges_of(map(len, pieces))
    return eliminate(
        np.concatenate(pieces), np.concatenate(by_state), linear_response(model),
        np.column_stack([edges[:-1], edges[:-1] + model.start_up, edges[1:]]),
        weights=weights, margins=margins)
