"""The elimination of initial states, compiled: of one part after another, see `elimination`."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.compiled import compiled
from hydro_twin.fitting.cholesky import solve_cholesky
from hydro_twin.predictors.system import BEYOND

UNOBSERVABLE = 1e-6     # of the linear response to a state: less shows nothing of it
RIDGE = 1e-4            # added to the diagonal of normal equations whose columns have an RMS of 1
RELATIVE = 1e-12        # of their trace, added, too: the first samples may not show every state


class Room(NamedTuple):
    """Scratch of an elimination of s derivatives from R other columns.

    Attributes:
        first, later: products of the derivatives with all columns, over the first samples of a
            part and over the later ones, (s, s + R).
        per: of each derivative one over its RMS, (s,); 0: it shows nothing of the state.
        normal, other: normal equations, (s, s).
        found: their solution for each of the other columns, (s, R).
        held: where a state is held at a bound, nan where it is not, (s,).
    """

    first: FloatArray
    later: FloatArray
    per: FloatArray
    normal: FloatArray
    other: FloatArray
    found: FloatArray
    held: FloatArray


def room_for(s: int, others: int) -> Room:
    """Allocate the scratch of an elimination of s derivatives from so many other columns."""
    return Room(*(np.empty(shape) for shape in (
        (s, s + others), (s, s + others), s, (s, s), (s, s), (s, others), s)))


@compiled
def eliminate_each(  # type: ignore[no-untyped-def]
        columns, parts, linear_response, margins, weights, left, change, explained, spread, room):
    """Eliminate the first s of the columns (N, s + R) from the others, see `eliminate`.

    Fills left (scored, R), change (P, s), explained (P,), spread (P,), the RMS of what is left,
    and those weights (P,) that are nan. A part whose run has diverged is left as it is.
    """
    s, at = change.shape[1], 0
    for k in range(len(parts)):
        begin, scored, end = parts[k, 0], parts[k, 1], parts[k, 2]
        early, late = max(scored - begin, 1), max(end - scored, 1)
        first_squares = multiply(columns, begin, scored, room.first)
        later_squares = multiply(columns, scored, end, room.later)
        finite = first_squares + later_squares < np.inf
        for a in range(s):
            for b in range(columns.shape[1]):
                finite = finite and abs(room.first[a, b]) + abs(room.later[a, b]) < np.inf
        for a in range(s):
            response = np.sqrt((room.first[a, a] + room.later[a, a]) / (end - begin))
            if a < len(linear_response) and response < UNOBSERVABLE * linear_response[a]:
                response = 0.0
            of_first = np.sqrt(room.first[a, a] / early)
            size = of_first if of_first > 1e-6 * response else response
            room.per[a] = 1.0 / size if response > 0.0 else 0.0
        if np.isnan(weights[k]):
            weights[k] = weight(first_squares / early, later_squares / late)
            if finite and swings(margins[k]):
                # The first samples hardly show how a load swings.
                weights[k] = max(weights[k] / amplification(room, early, late), 1.0)
        room.found[:] = 0.0
        if finite:
            solve_within(room, weights[k], margins[k])
        for a in range(s):
            for c in range(left.shape[1]):
                room.found[a, c] *= room.per[a]
            change[k, a] = room.found[a, 0]
        explained[k], spread[k] = 0.0, 0.0
        for i in range(scored, end):
            for c in range(left.shape[1]):
                value = columns[i, s + c]
                for a in range(s):
                    if room.found[a, c] != 0.0:     # zero times nan would be nan
                        value -= columns[i, a] * room.found[a, c]
                left[at, c] = value
            explained[k] += (columns[i, s] - left[at, 0])**2
            spread[k] += left[at, 0]**2
            at += 1
        explained[k], spread[k] = np.sqrt(explained[k] / late), np.sqrt(spread[k] / late)


@compiled
def multiply(columns, begin, end, into):  # type: ignore[no-untyped-def]
    """Fill the products of the first s columns with all (N, s + R) over some rows, (s, s + R).

    Returns the sum of squares of the column that follows the first s.
    """
    s, squares = len(into), 0.0
    into[:] = 0.0
    for i in range(begin, end):
        squares += columns[i, s] * columns[i, s]
        for a in range(s):
            value = columns[i, a]
            for b in range(a, columns.shape[1]):
                into[a, b] += value * columns[i, b]
    for a in range(s):
        for b in range(a):
            into[a, b] = into[b, a]
    return squares


@compiled
def weight(first, later):  # type: ignore[no-untyped-def]
    """Weigh the first samples of a part by the mean squares of the first and later residuals."""
    ratio = later / max(first, 1e-12 * later, 1e-300)
    return max(ratio, 1.0) if ratio < np.inf else 1.0


@compiled
def swings(margins):  # type: ignore[no-untyped-def]
    """Whether some state, with margins (s, 2), is that of a load that swings."""
    found = False
    for a in range(len(margins)):
        found = found or margins[a, 1] == BEYOND
    return found


@compiled
def amplification(room, early, late):  # type: ignore[no-untyped-def]
    """Return by how much noise in the initial states raises the later mean square.

    Over that of the first samples, by which the states are estimated: the covariance of the
    estimate, carried on to the later samples.
    """
    s, carried = len(room.per), 0.0
    for a in range(s):
        for b in range(s):
            room.normal[a, b] = room.per[a] * room.first[a, b] * room.per[b]
            room.other[a, b] = room.per[a] * room.later[a, b] * room.per[b]
    solve_cholesky(room.normal, room.other, ridge_of(room.normal))
    for a in range(s):
        carried += room.other[a, a]
    return (1.0 + carried / late) / max(1.0 - s / early, 0.1)


@compiled
def ridge_of(normal):  # type: ignore[no-untyped-def]
    """Return the ridge by which normal equations (s, s) can be solved."""
    trace = 0.0
    for a in range(len(normal)):
        trace += normal[a, a]
    return RIDGE + RELATIVE * trace


@compiled
def solve_within(room, weight, margins):  # type: ignore[no-untyped-def]
    """Solve the normal equations of a part; the changes of its state stay within margins, (s, 2).

    One that would leave them is held at the bound, where it no longer follows the other columns.
    """
    s = len(room.per)
    room.held[:] = np.nan
    for _ in range(s + 1):
        for a in range(s):
            for b in range(s):
                room.normal[a, b] = room.per[a] * room.per[b] * (
                    room.later[a, b] + weight * room.first[a, b])
            for c in range(room.found.shape[1]):
                room.found[a, c] = room.per[a] * (
                    room.later[a, s + c] + weight * room.first[a, s + c])
        ridge = ridge_of(room.normal)
        for a in range(s):
            if not np.isnan(room.held[a]):
                hold(room, a)
        solve_cholesky(room.normal, room.found, ridge)
        beyond = False
        for a in range(s):
            if not np.isnan(room.held[a]):
                room.found[a, 0] = room.held[a]
            elif room.per[a] > 0.0:
                low, high = margins[a, 0] / room.per[a], margins[a, 1] / room.per[a]
                if room.found[a, 0] < low or room.found[a, 0] > high:
                    room.held[a] = min(max(room.found[a, 0], low), high)
                    beyond = True
        if not beyond:
            break


@compiled
def hold(room, a):  # type: ignore[no-untyped-def]
    """Take a state that is held out of the normal equations of the others."""
    for b in range(len(room.per)):
        room.found[b, 0] -= room.normal[b, a] * room.held[a]
        room.normal[a, b] = room.normal[b, a] = 1.0 if a == b else 0.0
    for c in range(room.found.shape[1]):
        room.found[a, c] = 0.0
