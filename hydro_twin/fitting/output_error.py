"""The free runs of a model over parts, from the states that show there, and their errors."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_twin.fitting.beginnings import find_starts
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.start import Start, without_start
from hydro_twin.model import Model
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.sensitivities import run_parts_with_slopes
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import Directions, NONE, Tangent, tangents_of


def initial_states(model: Model, parts: Sequence[Part], near: Sequence[Start] = ()
                   ) -> list[Start]:
    """Find the state at the start of each part that its first samples show.

    Args:
        model: that is run.
        parts: over which.
        near: starts of a model that differs little, which are searched anew where they miss much.
    """
    system = model.system
    lengths = [part.beginning(model.start_up) for part in parts]
    stages = [system.stage_at(part.start) for part in parts]
    found: dict[int, Start] = {}
    for stage in sorted(set(stages)):
        here = [k for k, other in enumerate(stages) if other == stage]
        found |= zip(here, find_starts(
            system.stages[stage],
            [parts[k].inputs[:lengths[k]] for k in here],
            [parts[k].measured[:lengths[k]] for k in here],
            [max(1e-3 * parts[k].size, 1e-12) for k in here],
            [near[k] if near else None for k in here]), strict=True)
    return [found[k] for k in range(len(parts))]


def run_with_slopes(system: System, by: Directions, tangents: Sequence[Tangent],
                    parts: Sequence[Part], starts: Sequence[Start], sensors: Sequence[str] = ()
                    ) -> list[tuple[FloatArray, FloatArray]]:
    """Run over parts from their starts, with derivatives, see `run_parts_with_slopes`."""
    return run_parts_with_slopes(
        system, by, tangents, [part.inputs for part in parts], [start.x for start in starts],
        [start.z for start in starts], [part.start for part in parts], sensors)


def usual_response(model: Model) -> FloatArray:
    """RMS of the output's response to the state at the start, linear laws, (n,)."""
    response: FloatArray = np.sqrt(np.mean(
        model.system.free_response(model.start_up)**2, axis=0))
    return response


def free_run(model: Model, part: Part, seen: FloatArray | None = None) -> FloatArray:
    """Run freely over a part, from the state that its first samples show; (N,).

    What passes at the ports is written to `seen`, see `System.run`.
    """
    start, = initial_states(model, [part])
    return model.system.run(part.inputs, start.x, start.z, seen, part.start)


def residuals(model: Model, parts: Sequence[Part]) -> list[FloatArray]:
    """Measured less free run over the scored samples of each part, whitened, (N - start-up,)."""
    return [part.whitened(part.measured - model.system.run(
        part.inputs, start.x, start.z, start=part.start))[model.start_up:]
            for part, start in zip(parts, initial_states(model, parts), strict=True)]


def fitted_residuals(model: Model, parts: Sequence[Part]) -> list[FloatArray]:
    """Find the residual of each part that is left if the whole of it shows its start.

    See `without_start`. What is not fitted has only its first samples to go by.
    """
    starts, usual = initial_states(model, parts), usual_response(model)
    tangents = tangents_of(model.system, lambda _: NONE)
    runs = run_with_slopes(model.system, NONE, tangents, parts, starts)
    return [without_start(part.whitened(part.measured - y[0]), part.whitened(slopes[0]), usual,
                          model.start_up, room=start.room).residual
            for part, start, (y, slopes) in zip(parts, starts, runs, strict=True)]


def residuals_from(model: Model, parts: Sequence[Part], states: Sequence[FloatArray]
                   ) -> list[FloatArray]:
    """Find the residuals of runs from given states, less what others explain by linear laws.

    A quicker `fitted_residuals`, to compare many effects: no start is searched, and what effects
    keep is zero at first.

    Args:
        model: what is run.
        parts: what it is run over.
        states: at the start of each, (n,).
    """
    system, usual = model.system, usual_response(model)
    response = system.free_response(max(len(part.measured) for part in parts))
    return [without_start(
        part.whitened(part.measured - system.run(part.inputs, x, start=part.start)),
        part.whitened(response[:len(part.measured)]), usual, model.start_up).residual
            for part, x in zip(parts, states, strict=True)]
