"""The state at which a run starts, as the first samples measured show it."""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms

HIDDEN = 1e-6           # of the response that a state has by the linear laws: none


class Start(NamedTuple):
    """The state at which a run starts.

    Attributes:
        x: of the plant, (n,).
        z: what the effects keep, (memory,).
        room: how far that can be off, down and up, (memory, 2): a follower of a play is somewhere
            between its edges.
        missed: RMS of what a run from there misses of the first samples.
    """

    x: FloatArray
    z: FloatArray
    room: FloatArray
    missed: float = math.inf

    def moved(self, change: FloatArray) -> Start:
        """Move state and memory, (n + memory,)."""
        n = len(self.x)
        return self._replace(x=self.x + change[:n], z=self.z + change[n:],
                             room=self.room - change[n:, None])


class Eliminated(NamedTuple):
    """What is left of a run where the state at its start is eliminated.

    Attributes:
        residual: over the scored samples, (scored,).
        slopes: how the output rises there by the other unknowns, the start following, (scored, d).
        change: of the state at the start, which explains what was taken off, (n + memory,).
        taken: RMS of that over the scored samples.
        weight: of the first samples over the later ones.
    """

    residual: FloatArray
    slopes: FloatArray
    change: FloatArray
    taken: float
    weight: float


def without_start(missed: FloatArray, by_start: FloatArray, usual: FloatArray, start_up: int,
                  by_others: FloatArray | None = None, weight: float | None = None,
                  room: FloatArray | None = None) -> Eliminated:
    """Eliminate the state at the start of a run by linear least squares (variable projection).

    The first samples show it with some error, which lasts where the plant integrates, or forgets
    slowly, and would be taken for an error of the laws. So what a better state explains is taken
    off, weighting first and later samples by how well they are fitted: what the laws miss later on
    must not be attributed to the start. What the effects keep changes no further than it has room:
    beyond, the derivatives are those of no law, as of a narrow hysteresis that would explain any
    drift of a valve at rest.

    Args:
        missed: measured less run, (N,).
        by_start: derivatives of the run by the state at the start, (N, n + memory).
        usual: how much of that the linear laws have, RMS, (n,). Less than `HIDDEN` of it says
            nothing of the state, as where a piston stands at the end of its stroke.
        start_up: first samples, which are not scored.
        by_others: derivatives of the run by other unknowns, (N, d).
        weight: of the first samples, if it is to be kept.
        room: of the memory, see `Start`; None: as much as it takes.
    """
    count = by_start.shape[1]
    # One after another: the state at the start, what is missed, other unknowns.
    every = np.column_stack([by_start, missed, *([] if by_others is None else [by_others])])
    early, late = every[:start_up], every[start_up:]
    with np.errstate(over='ignore', invalid='ignore'):      # such a run is left as it is, below
        first, later = early.T @ early, late.T @ late
        powers = first.diagonal() / max(len(early), 1), later.diagonal() / max(len(late), 1)
        if weight is None:
            begins, goes_on = float(powers[0][count]), float(powers[1][count])
            ratio = goes_on / max(begins, 1e-12 * goes_on, 1e-300)
            weight = max(ratio, 1.0) if math.isfinite(ratio) else 1.0
        shown = np.sqrt(powers[0][:count])
        at_all = np.sqrt((first.diagonal() + later.diagonal())[:count] / len(every))
        at_all[:len(usual)][at_all[:len(usual)] < HIDDEN * usual] = 0.0
        shown = np.where(shown > 1e-6 * at_all, shown, at_all)
        per = np.divide(1.0, shown, out=np.zeros(count), where=at_all > 0.0)
        both = later + weight * first
        normal = per[:, None] * both[:count, :count] * per
    moves = np.zeros((count, every.shape[1] - count))
    if np.isfinite(first).all() and np.isfinite(later).all():
        # Relative, too: where the first samples weigh most, they may not show every state.
        normal.flat[::count + 1] += 1e-4 + 1e-12 * normal.trace()
        room = np.zeros((0, 2)) if room is None else room * np.where(
            at_all > 0.0, shown, 0.0)[len(usual):, None]
        moves = per[:, None] * _within(normal, per[:, None] * both[:count, count:], room)
    taken = late[:, :count] @ moves
    left = late[:, count:] - taken
    return Eliminated(left[:, 0], left[:, 1:], moves[:, 0], rms(taken[:, 0]), weight)


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
