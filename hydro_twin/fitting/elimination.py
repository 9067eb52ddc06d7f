"""Elimination of the initial states from a fit by variable projection [Golub and Pereyra 1973]."""
from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled
from hydro_twin.fitting.initial_states import InitialStates
from hydro_twin.fitting.parts import edges_of
from hydro_twin.predictors.system import BEYOND

UNOBSERVABLE = 1e-6     # of the linear response to a state: less shows nothing of it
SMALL = 0.1             # of the residual: a change that explains less hardly alters the Jacobian
AS_GOOD = 1.02          # RMS of a rerun over the predicted one: the linearisation holds
RERUNS = 4              # at most: each squares the error of an initial state
RIDGE = 1e-4            # added to the diagonal of normal equations whose columns have an RMS of 1
RELATIVE = 1e-12        # of their trace, added, too: the first samples may not show every state


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
    s = by_state.shape[1]
    columns = np.column_stack([by_state, residual, *([] if by_unknowns is None
                                                     else [by_unknowns])])
    first, later = np.zeros((2, len(parts), columns.shape[1], columns.shape[1]))
    add_products(columns, parts, first, later)
    finite = np.isfinite(first).all(axis=(1, 2)) & np.isfinite(later).all(axis=(1, 2))
    early, late = np.diff(parts, axis=1).T
    first_squares, later_squares = (np.diagonal(some, axis1=1, axis2=2)
                                    for some in (first, later))
    with np.errstate(over='ignore', invalid='ignore'):      # a diverged run is left as it is
        scale = np.sqrt(first_squares[:, :s] / np.maximum(early, 1)[:, None])
        response = np.sqrt((first_squares + later_squares)[:, :s] / (early + late)[:, None])
        n = len(linear_response)
        response[:, :n][response[:, :n] < UNOBSERVABLE * linear_response] = 0.0
        scale = np.where(scale > 1e-6 * response, scale, response)
        per = np.divide(1.0, scale, out=np.zeros(scale.shape), where=response > 0.0)[..., None]
        if weights is None:
            weights = _weights(first_squares[:, s] / np.maximum(early, 1),
                               later_squares[:, s] / np.maximum(late, 1))
            if margins is not None and (margins == BEYOND).any():
                # The first samples hardly show how a load swings.
                weights = np.maximum(weights / _amplification(
                    np.stack([first, later])[..., :s, :s], per, early, late), 1.0)
        weighted = later + weights[:, None, None] * first
        normal = _scaled(weighted[:, :s, :s], per)
        right = per * weighted[:, :s, s:]
    normal[~finite], right[~finite] = np.eye(s), 0.0
    _add_ridge(normal)
    change = np.linalg.solve(normal, right)
    if margins is not None:
        shows = (response > 0.0)[..., None]
        bounds = np.where(shows, margins, 0.0) * np.where(shows, scale[..., None], 1.0)
        wanted = change[:, :, 0]
        for k in np.flatnonzero(((wanted < bounds[..., 0]) | (wanted > bounds[..., 1])
                                 ).any(axis=1) & finite):
            change[k] = _solve_bounded(normal[k], right[k], bounds[k])
    change = per * change
    edges = edges_of(late)
    left = np.empty((edges[-1], columns.shape[1] - s))
    subtract_explained(columns, parts, change, left)
    scored = np.concatenate([columns[begin:end, s] for _, begin, end in parts.tolist()])
    return Eliminated(left[:, 0], left[:, 1:], edges, change[:, :, 0],
                      rms_of_each(scored - left[:, 0], edges), rms_of_each(left[:, 0], edges),
                      weights)


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


def _scaled(products: FloatArray, per: FloatArray) -> FloatArray:
    """Turn products of columns (..., P, s, s) into those of the columns over their scales."""
    scaled: FloatArray = per * products * per.transpose(0, 2, 1)
    return scaled


def _add_ridge(normal: FloatArray) -> None:
    """Add a ridge to the diagonals of normal equations (P, s, s), so that they can be solved."""
    every = np.arange(normal.shape[-1])
    normal[:, every, every] += RIDGE + RELATIVE * np.trace(normal, axis1=1, axis2=2)[:, None]


def _amplification(products: FloatArray, per: FloatArray, early: IntArray, late: IntArray
                   ) -> FloatArray:
    """Return by how much noise in the initial states raises later mean squares, (P,).

    Over that of the first samples, by which the states are estimated: the covariance of the
    estimate, carried on to the later samples.

    Args:
        products: of the derivatives by the states, over the first samples and the later ones,
            (2, P, s, s).
        per: of each derivative one over its scale, (P, s, 1).
        early: how many samples come first, (P,).
        late: and later, (P,).
    """
    finite, s = np.isfinite(products).all(axis=(0, 2, 3)), products.shape[-1]
    first, later = _scaled(products[:, finite], per[finite])
    _add_ridge(first)
    carried = np.trace(np.linalg.solve(first, later), axis1=1, axis2=2)
    found = np.ones(products.shape[1])
    found[finite] = (1.0 + carried / late[finite]) / np.maximum(1.0 - s / early[finite], 0.1)
    return found


def _weights(first: FloatArray, later: FloatArray) -> FloatArray:
    """Weigh the first samples by the mean squares of the first and later residuals, (P,)."""
    ratio = later / np.maximum(np.maximum(first, 1e-12 * later), 1e-300)
    return np.where(np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0)


def rms_of_each(values: FloatArray, edges: IntArray) -> FloatArray:
    """RMS of values (N,) between each two edges, (P,); no two of them are the same."""
    found: FloatArray = np.sqrt(np.add.reduceat(values * values, edges[:-1]) / np.diff(edges))
    return found


@compiled
def add_products(columns, parts, first, later):  # type: ignore[no-untyped-def]
    """Add the products of columns (N, C) to (P, C, C): over the first rows, and the later ones."""
    for k in range(len(parts)):
        for half in range(2):
            into = later[k] if half else first[k]
            for i in range(parts[k, half], parts[k, half + 1]):
                for a in range(columns.shape[1]):
                    value = columns[i, a]
                    for b in range(a + 1):
                        into[a, b] += value * columns[i, b]
            for a in range(columns.shape[1]):
                for b in range(a):
                    into[b, a] = into[a, b]


@compiled
def subtract_explained(columns, parts, change, left):  # type: ignore[no-untyped-def]
    """Subtract the first s columns, times the change, from the others in the scored rows.

    Fills left (scored, C - s) from columns (N, C) and change (P, s, C - s). Where that is zero
    nothing is subtracted, finite or not.
    """
    s, at = change.shape[1], 0
    for k in range(len(parts)):
        for i in range(parts[k, 1], parts[k, 2]):
            for c in range(left.shape[1]):
                value = columns[i, s + c]
                for a in range(s):
                    if change[k, a, c] != 0.0:
                        value -= columns[i, a] * change[k, a, c]
                left[at, c] = value
            at += 1


def _solve_bounded(normal: FloatArray, right: FloatArray, bounds: FloatArray) -> FloatArray:
    """Solve normal equations; the unknowns of the first column stay within bounds, (s, 2).

    One that would leave them is held at the bound, where it no longer follows the other columns.
    """
    free = np.ones(len(normal), dtype=bool)
    found: FloatArray = np.linalg.solve(normal, right)
    for _ in bounds:
        wanted = found[:, 0].copy()
        within = np.clip(wanted, bounds[:, 0], bounds[:, 1])
        beyond = within != wanted
        if not beyond.any():
            break
        free[beyond] = False
        found[:, 0] = within
        found[~free, 1:] = 0.0
        rest = right[free] - normal[np.ix_(free, ~free)] @ found[~free]
        found[free] = np.linalg.solve(normal[np.ix_(free, free)], rest)
    return found
