"""The states at which runs over parts start, as the samples measured show them."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled
from hydro_twin.fitting.parts import edges_of

HIDDEN = 1e-6           # of the response that a state has by the linear laws: none
SMALL = 0.1             # of the residual: a start that takes off less hardly turns the slopes
AS_GOOD = 1.02          # RMS from a moved start over what elimination promised: it was right
AGAIN = 4               # most runs from moved starts: each squares the error of a start


@dataclass(frozen=True)
class Starts:
    """The states at which runs over P parts start.

    Attributes:
        x: of the plant, (P, n).
        z: what the effects keep, (P, memory).
        room: how far that can be off, down and up, (P, memory, 2): a follower of a play is
            somewhere between its edges.
        missed: RMS of what a run from there misses of the first samples, (P,).
    """

    x: FloatArray
    z: FloatArray
    room: FloatArray
    missed: FloatArray

    def __len__(self) -> int:
        return len(self.x)

    def at(self, parts: IntArray) -> Starts:
        """Take those of some parts."""
        return Starts(self.x[parts], self.z[parts], self.room[parts], self.missed[parts])

    def moved(self, change: FloatArray) -> Starts:
        """Move states and memory, (P, n + memory)."""
        n = self.x.shape[1]
        return replace(self, x=self.x + change[:, :n], z=self.z + change[:, n:],
                       room=self.room - change[:, n:, None])

    def with_others(self, parts: IntArray, others: Starts) -> Starts:
        """Put others in the place of those of some parts."""
        found = self.at(np.arange(len(self)))
        for now, then in ((found.x, others.x), (found.z, others.z), (found.room, others.room),
                          (found.missed, others.missed)):
            now[parts] = then
        return found


class Eliminated(NamedTuple):
    """What is left of runs over P parts where the states at their starts are eliminated.

    Attributes:
        residual: over the scored samples of all parts, (scored,).
        slopes: how the output rises there by the other unknowns, the start following, (scored, d).
        edges: where each part begins there, and where the last one ends, (P + 1,).
        change: of the states at the start, which explains what was taken off, (P, n + memory).
        taken: RMS of that over the scored samples, (P,).
        errors: RMS of the residual, (P,).
        weights: of the first samples over the later ones, (P,).
    """

    residual: FloatArray
    slopes: FloatArray
    edges: IntArray
    change: FloatArray
    taken: FloatArray
    errors: FloatArray
    weights: FloatArray


RunFrom = Callable[[IntArray, Starts, FloatArray | None], Eliminated]


def without_starts(missed: FloatArray, by_start: FloatArray, usual: FloatArray, parts: IntArray,
                   by_others: FloatArray | None = None, weights: FloatArray | None = None,
                   room: FloatArray | None = None) -> Eliminated:
    """Eliminate the states at the starts of runs by linear least squares (variable projection).

    The first samples show them with some error, which lasts where the plant integrates, or forgets
    slowly, and would be taken for an error of the laws. So what a better state explains is taken
    off, weighting first and later samples by how well they are fitted: what the laws miss later on
    must not be attributed to the start. What the effects keep changes no further than it has room:
    beyond, the derivatives are those of no law, as of a narrow hysteresis that would explain any
    drift of a valve at rest.

    Args:
        missed: measured less run, of all parts, (N,).
        by_start: derivatives of the run by the state at the start of its part, (N, n + memory).
        usual: how much of that the linear laws have, RMS, (n,). Less than `HIDDEN` of it says
            nothing of the state, as where a piston stands at the end of its stroke.
        parts: of each its first row, its first row that is scored, and the one after its last,
            (P, 3).
        by_others: derivatives of the run by other unknowns, (N, d).
        weights: of the first samples, if they are to be kept.
        room: of the memory, see `Starts`; None: as much as it takes.
    """
    s = by_start.shape[1]
    # One after another: the state at the start, what is missed, other unknowns.
    rows = np.column_stack([by_start, missed, *([] if by_others is None else [by_others])])
    first, later = np.zeros((2, len(parts), rows.shape[1], rows.shape[1]))
    products(rows, parts, first, later)
    finite = np.isfinite(first).all(axis=(1, 2)) & np.isfinite(later).all(axis=(1, 2))
    early, late = np.diff(parts, axis=1).T
    begins, goes_on = (np.diagonal(some, axis1=1, axis2=2) for some in (first, later))
    with np.errstate(over='ignore', invalid='ignore'):      # such a run is left as it is, below
        shown = np.sqrt(begins[:, :s] / np.maximum(early, 1)[:, None])
        at_all = np.sqrt((begins + goes_on)[:, :s] / (early + late)[:, None])
        at_all[:, :len(usual)][at_all[:, :len(usual)] < HIDDEN * usual] = 0.0
        shown = np.where(shown > 1e-6 * at_all, shown, at_all)
        if weights is None:
            weights = _weights(begins[:, s] / np.maximum(early, 1),
                               goes_on[:, s] / np.maximum(late, 1))
        per = np.divide(1.0, shown, out=np.zeros(shown.shape), where=at_all > 0.0)[..., None]
        both = later + weights[:, None, None] * first
        normal = per * both[:, :s, :s] * per.transpose(0, 2, 1)
        right = per * both[:, :s, s:]
    normal[~finite], right[~finite] = np.eye(s), 0.0
    # Relative, too: where the first samples weigh most, they may not show every state.
    every = np.arange(s)
    normal[:, every, every] += 1e-4 + 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None]
    moves = np.linalg.solve(normal, right)
    if room is not None:
        within = room * np.where(at_all > 0.0, shown, 0.0)[:, len(usual):, None]
        wanted = moves[:, len(usual):, 0]
        for k in np.flatnonzero(((wanted < within[..., 0]) | (wanted > within[..., 1])
                                 ).any(axis=1) & finite):
            moves[k] = _within(normal[k], right[k], within[k])
    moves = per * moves
    edges = edges_of(late)
    left = np.empty((edges[-1], rows.shape[1] - s))
    take_off(rows, parts, moves, left)
    scored = np.concatenate([rows[begin:end, s] for _, begin, end in parts.tolist()])
    return Eliminated(left[:, 0], left[:, 1:], edges, moves[:, :, 0],
                      rms_of_each(scored - left[:, 0], edges), rms_of_each(left[:, 0], edges),
                      weights)


def eliminate_starts(run_from: RunFrom, starts: Starts, weights: FloatArray | None = None,
                     in_search: bool = False) -> tuple[Eliminated, Starts]:
    """Run over all parts and eliminate the states at their starts, again where they move far.

    The derivatives belong to the runs: where elimination moves the start of one by much, it runs
    again from there, and what is left then counts, if it is no more than promised, and so on, up
    to `AGAIN` times. So a mass that begins near an unstable equilibrium follows the way that it
    took.

    In a search it runs again once, for the derivatives and for the starts of the next evaluation,
    and what is left stays as promised: where it were now the one and now the other, no descent
    would lead through the sum of squares.

    Args:
        run_from: runs over some parts from their starts, and eliminates these.
        starts: of all parts.
        weights: of the first samples, if they are to be kept.
        in_search: whether it is an evaluation of a search.

    Returns:
        What is left, and the starts of the last runs.
    """
    runs = run_from(np.arange(len(starts)), starts, weights)
    left = np.arange(len(starts))
    for _ in range(1 if in_search else AGAIN):
        left = left[runs.taken[left] > SMALL * runs.errors[left]]
        if not len(left):
            break
        there = starts.at(left).moved(runs.change[left])
        again = run_from(left, there, runs.weights[left])
        finite = np.minimum.reduceat(np.isfinite(again.slopes).all(axis=1), again.edges[:-1])
        better = finite & (again.errors < AS_GOOD * runs.errors[left])
        for j in np.flatnonzero(finite):
            here, after = slice(*runs.edges[left[j]:left[j] + 2]), slice(*again.edges[j:j + 2])
            runs.slopes[here] = again.slopes[after]
            if better[j] and not in_search:
                runs.residual[here] = again.residual[after]
        left = left[better]
        for now, then in ((runs.change, again.change), (runs.taken, again.taken),
                          (runs.errors, again.errors)):
            now[left] = then[better]
        starts = starts.with_others(left, there.at(np.flatnonzero(better)))
    return runs, starts


def _weights(begins: FloatArray, goes_on: FloatArray) -> FloatArray:
    """Weigh the first samples by the mean squares missed of them and of the later ones, (P,)."""
    ratio = goes_on / np.maximum(np.maximum(begins, 1e-12 * goes_on), 1e-300)
    return np.where(np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0)


def rms_of_each(values: FloatArray, edges: IntArray) -> FloatArray:
    """RMS of values (N,) between each two edges, (P,); no two of them are the same."""
    found: FloatArray = np.sqrt(np.add.reduceat(values * values, edges[:-1]) / np.diff(edges))
    return found


@compiled
def products(rows, parts, first, later):  # type: ignore[no-untyped-def]
    """Add the products of columns of rows (N, C) to (P, C, C): over first rows, and later ones."""
    for k in range(len(parts)):
        for half in range(2):
            into = later[k] if half else first[k]
            for i in range(parts[k, half], parts[k, half + 1]):
                for a in range(rows.shape[1]):
                    value = rows[i, a]
                    for b in range(a + 1):
                        into[a, b] += value * rows[i, b]
            for a in range(rows.shape[1]):
                for b in range(a):
                    into[b, a] = into[a, b]


@compiled
def take_off(rows, parts, moves, left):  # type: ignore[no-untyped-def]
    """Fill left (scored, C - s) with the scored rows (N, C), less their first s times the moves.

    Those are (P, s, C - s). Where they are zero, nothing is taken off, finite or not.
    """
    s, at = moves.shape[1], 0
    for k in range(len(parts)):
        for i in range(parts[k, 1], parts[k, 2]):
            for c in range(left.shape[1]):
                value = rows[i, s + c]
                for a in range(s):
                    if moves[k, a, c] != 0.0:
                        value -= rows[i, a] * moves[k, a, c]
                left[at, c] = value
            at += 1


def _within(normal: FloatArray, right: FloatArray, room: FloatArray) -> FloatArray:
    """Solve normal equations; the last unknowns of the first column stay within their room.

    One that would leave it is held at the edge, where it no longer moves with the other columns.
    """
    free = np.ones(len(normal), dtype=bool)
    limited = np.arange(len(normal) - len(room), len(normal))
    found: FloatArray = np.linalg.solve(normal, right)
    for _ in room:
        wanted = found[limited, 0]
        within = np.clip(wanted, room[:, 0], room[:, 1])
        beyond = limited[within != wanted]
        if not len(beyond):
            break
        free[beyond] = False
        found[limited, 0] = within
        found[~free, 1:] = 0.0
        rest = right[free] - normal[np.ix_(free, ~free)] @ found[~free]
        found[free] = np.linalg.solve(normal[np.ix_(free, free)], rest)
    return found
