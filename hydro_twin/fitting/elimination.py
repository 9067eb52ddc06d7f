"""Elimination of the initial states from a fit by variable projection [Golub and Pereyra 1973]."""
from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.initial_states import InitialStates
from hydro_twin.fitting.parts import edges_of
from hydro_twin.fitting.projection import eliminate_each, room_for

SMALL = 0.1             # of the residual: a change that explains less hardly alters the Jacobian
AS_GOOD = 1.02          # RMS of a rerun over the predicted one: the linearisation holds
RERUNS = 4              # at most: each squares the error of an initial state


class Eliminated(NamedTuple):
    """Runs over P parts after the elimination of their initial states.

    Attributes:
        residual: over the scored samples of all parts, (scored,).
        jacobian: derivatives of the output by the unknowns, the initial state following,
            (scored, d).
        edges: where each part begins there, and where the last one ends, (P + 1,).
        change: of the initial states, (P, n + memory).
        explained: RMS of what that takes off the residual, (P,).
        rms: of the residual, (P,).
        weights: of the first samples relative to the later ones, (P,).
    """

    residual: FloatArray
    jacobian: FloatArray
    edges: IntArray
    change: FloatArray
    explained: FloatArray
    rms: FloatArray
    weights: FloatArray


RunFrom = Callable[[IntArray, InitialStates, FloatArray | None], Eliminated]


def eliminate(residual: FloatArray, by_state: FloatArray, linear_response: FloatArray,
              parts: IntArray, by_unknowns: FloatArray | None = None,
              weights: FloatArray | None = None, margins: FloatArray | None = None
              ) -> Eliminated:
    """Eliminate the initial states of runs by linear least squares.

    An initial state estimated from the first samples has an error. Where the plant integrates, or
    forgets slowly, this error lasts and would be attributed to the laws. So the part of the
    residual that a change of the initial state explains is removed. First and later samples are
    weighted by how well they are fitted: a model error that shows later must not be attributed to
    the initial state. The memory of the effects changes within its margins only: beyond them the
    derivatives belong to no law, and a narrow hysteresis would explain any drift of a valve at
    rest. Nor does a valve begin further open than any command asks for: that would explain the
    movement of a whole window.

    Args:
        residual: measured minus predicted output, of all parts, (N,).
        by_state: derivatives of the output by the initial state of its part, (N, n + memory).
        linear_response: RMS of these derivatives by the linear laws, (n,). A response below
            `UNOBSERVABLE` of it shows nothing of the state, as where a piston stands at the end
            of its stroke.
        parts: of each its first row, its first row that is scored, and the one after its last,
            (P, 3).
        by_unknowns: derivatives of the output by the other unknowns, (N, d).
        weights: of the first samples, if they are to be kept.
        margins: of states and memory, see `InitialStates`; None: no limit.
    """
    s, count = by_state.shape[1], len(parts)
    columns = np.column_stack([by_state, residual, *([] if by_unknowns is None
                                                     else [by_unknowns])])
    # nan: not given.
    margins = np.full((count, s, 2), math.nan) if margins is None else margins
    weights = np.full(count, math.nan) if weights is None else weights.copy()
    edges = edges_of(parts[:, 2] - parts[:, 1])
    left = np.empty((edges[-1], columns.shape[1] - s))
    change, explained, spread = np.empty((count, s)), np.empty(count), np.empty(count)
    eliminate_each(columns, parts, linear_response, margins, weights, left, change, explained,
                   spread, room_for(s, left.shape[1]))
    return Eliminated(left[:, 0], left[:, 1:], edges, change, explained, spread, weights)


def eliminate_with_reruns(run_from: RunFrom, initial: InitialStates,
                          weights: FloatArray | None = None, in_search: bool = False
                          ) -> tuple[Eliminated, InitialStates]:
    """Run over all parts and eliminate their initial states, with reruns after large changes.

    The derivatives hold near the states that the runs began at. A part whose initial state
    changes by much is run again from the new one, up to `RERUNS` times, and the residual of the
    rerun counts if it is no larger than predicted. So a mass that begins near an unstable
    equilibrium follows the way that it took.

    In a search there is one rerun, which gives the Jacobian and the initial states of the next
    evaluation. The residual stays the predicted one: with now one and now the other, the sum of
    squares would have steps that no descent leads through.

    Args:
        run_from: runs over some parts from their initial states, and eliminates these.
        initial: the initial states of all parts.
        weights: of the first samples, if they are to be kept.
        in_search: whether it is an evaluation of a search.

    Returns:
        The runs after elimination, and the initial states of the last ones.
    """
    runs = run_from(np.arange(len(initial)), initial, weights)
    parts = np.arange(len(initial))
    for _ in range(1 if in_search else RERUNS):
        parts = parts[runs.explained[parts] > SMALL * runs.rms[parts]]
        if not len(parts):
            break
        moved = initial.at(parts).moved(runs.change[parts])
        again = run_from(parts, moved, runs.weights[parts])
        finite = np.minimum.reduceat(np.isfinite(again.jacobian).all(axis=1), again.edges[:-1])
        better = finite & (again.rms < AS_GOOD * runs.rms[parts])
        for j in np.flatnonzero(finite):
            rows, new = slice(*runs.edges[parts[j]:parts[j] + 2]), slice(*again.edges[j:j + 2])
            runs.jacobian[rows] = again.jacobian[new]
            if better[j] and not in_search:
                runs.residual[rows] = again.residual[new]
        parts = parts[better]
        for values, after in ((runs.change, again.change), (runs.explained, again.explained),
                              (runs.rms, again.rms)):
            values[parts] = after[better]
        initial = initial.with_others(parts, moved.at(np.flatnonzero(better)))
    return runs, initial
