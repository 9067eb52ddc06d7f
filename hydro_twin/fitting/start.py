"""The state at which a run starts, as the first samples measured show it."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.sensitivities import run_with_slopes
from hydro_twin.predictors.system import IntArray, System
from hydro_twin.predictors.tangents import NONE, Tangent

MOVES = 0.5             # of the mean square missed: less is left where a run starts otherwise
NEARER = 0.9            # of the mean square missed: more is left by the last step of a search
NEAR = 0.05             # of the movement: a start that misses less is not on a wrong side
STEPS = 8               # of that search
HIDDEN = 1e-6           # of the response that a state has by the linear laws: none
HELD = 0.01             # cost of a deviation from rest, over that of as large an output
DAMPED = (HELD, 0.3, 10.0)      # and of one from the last step


class Start(NamedTuple):
    """The state at which a run starts.

    Attributes:
        x: of the plant, (n,).
        z: what the effects keep, (memory,).
        room: how far that can be off, down and up, (memory, 2): a follower of a play is somewhere
            between its edges.
    """

    x: FloatArray
    z: FloatArray
    room: FloatArray

    def moved(self, change: FloatArray) -> Start:
        """Move state and memory, (n + memory,)."""
        n = len(self.x)
        return Start(self.x + change[:n], self.z + change[n:], self.room - change[n:, None])


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
    others = np.zeros((len(missed), 0)) if by_others is None else by_others
    both = np.column_stack([missed, others])
    first, later = missed[:start_up], missed[start_up:]
    if weight is None:
        least = max(rms(first), 1e-6 * rms(later), 1e-150)
        weight = max((rms(later) / least) ** 2, 1.0) if math.isfinite(rms(later)) else 1.0
    with np.errstate(over='ignore', invalid='ignore'):      # such a run is left as it is, below
        shown = np.sqrt(np.mean(by_start[:start_up]**2, axis=0))
        at_all = np.sqrt(np.mean(by_start**2, axis=0))
        at_all[:len(usual)][at_all[:len(usual)] < HIDDEN * usual] = 0.0
        shown = np.where(shown > 1e-6 * at_all, shown, at_all)
        shown = np.where(at_all > 0.0, shown, np.inf)
        columns = by_start / shown
    found = np.zeros((columns.shape[1], both.shape[1]))
    if np.isfinite(missed).all() and np.isfinite(columns).all():
        early, late = columns[:start_up], columns[start_up:]
        normal = late.T @ late + weight * early.T @ early
        # Relative, too: where the first samples weigh most, they may not show every state.
        normal += (1e-4 + 1e-12 * np.trace(normal)) * np.eye(len(normal))
        room = np.zeros((0, 2)) if room is None else room * np.where(
            at_all > 0.0, shown, 0.0)[len(usual):, None]
        found = _within(normal, late.T @ both[start_up:] + weight * early.T @ both[:start_up],
                        room)
    taken = columns[start_up:] @ found
    left = both[start_up:] - taken
    return Eliminated(left[:, 0], left[:, 1:], found[:, 0] / shown, rms(taken[:, 0]), weight)


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


def find_start(system: System, tangent: Tangent, response: FloatArray, inputs: FloatArray,
               measured: FloatArray, least: float) -> Start:
    """Find the state from which the output is least missed.

    From rest, by a search with damped steps [Levenberg 1944], under the whole model. States that
    the output does not show stay near rest: a deviation costs as if the output were measured to
    one per cent. Where a gap may stand on either side, a search ends at any; and what a play holds
    is zero in it. So, where much is missed, it starts again from other sides, with what is
    kept as one more coordinate.

    Args:
        system: the model, as it is at the start.
        tangent: of a step of it by the state only.
        response: how the output moves with the state, linear laws, (N, n).
        inputs: (N, m).
        measured: the output, (N,).
        least: movement of the output that is worth following, above zero.
    """
    rest = system.start(inputs[0], measured[0])
    kept = system.kept(inputs[0], rest)
    n, width = len(rest), kept[:, 1] - kept[:, 0]
    size = max(rms(measured - measured.mean()), least)
    shown = np.sqrt(np.mean(response**2, axis=0))
    scale = np.concatenate([size / np.where(shown > 0.0, shown, 1.0), width])
    every = np.flatnonzero(scale > 0.0)
    units = np.diag(scale)
    linear = np.hstack([response * scale[:n], np.zeros((len(measured), len(width)))])

    def at(state: FloatArray) -> _At:
        missed = measured - system.run(inputs, state[:n], state[n:])
        power = float(missed @ missed)
        return _At(state, missed, power if math.isfinite(power) else math.inf)

    def explained(missed: FloatArray, columns: FloatArray, held: float) -> FloatArray:
        """Return the coordinates that explain what outputs (N, K) miss, (n + memory, K)."""
        if not np.isfinite(columns).all():
            return np.zeros((len(scale), missed.shape[1]))
        normal = columns.T @ columns
        ridge = (held * size) ** 2 + 1e-12 * np.trace(normal)
        found: FloatArray = np.linalg.solve(
            normal + max(ridge, 1e-300) * np.eye(len(scale)), columns.T @ missed)
        return found

    def step(here: _At, columns: FloatArray, held: float, enough: float) -> _At:
        """Move the state if that leaves little enough of the mean square."""
        if not np.isfinite(here.power):
            return here
        moved = explained(here.missed[:, None], columns, held)[:, 0]
        predicted = here.missed - columns @ moved
        if not predicted @ predicted < enough * here.power:
            return here
        there = at(here.state + scale * moved)
        return there if there.power < enough * here.power else here

    def slopes(here: _At, free: IntArray) -> FloatArray:
        """Return the derivatives of the output by free coordinates, (N, n + memory)."""
        columns = np.zeros(linear.shape)
        _, found = run_with_slopes(system, NONE, (tangent,), inputs, here.state[:n],
                                   here.state[n:])
        columns[:, free] = (found * scale)[:, free]
        return columns

    def search(here: _At, free: IntArray) -> tuple[_At, FloatArray]:
        """Search from a state along free coordinates; returns also the slopes at the end."""
        # What sticks at rest has no derivative there: first by the linear laws, if it moves.
        here, columns = step(here, linear, HELD, MOVES), linear
        for _ in range(STEPS):
            columns, before = slopes(here, free), here
            for held in DAMPED:
                if here is before:
                    here = step(here, columns, held, NEARER)
            if here is before:
                break
        return here, columns

    here = at(np.concatenate([rest, np.zeros(len(width))]))
    if len(system.step.effects) == 0:
        return Start(step(here, linear, HELD, 1.0).state, np.zeros(0), np.zeros((0, 2)))
    best, columns = search(here, every[every < n])
    if best.power > (NEAR * size) ** 2 * len(measured):
        sides = [best.state + side * unit for unit in units[:n] for side in (-1.0, 1.0)]
        for i in np.flatnonzero(width):
            sides += [np.where(np.arange(len(scale)) == n + i, value, best.state)
                      for value in (*kept[i], kept[i].mean())]
        begun = np.array(sides)
        missed = measured - system.run_each(inputs, begun)
        begun += (scale[:, None] * explained(np.nan_to_num(missed).T, columns, HELD)).T
        missed = measured - system.run_each(inputs, begun)
        powers = np.nan_to_num(np.sum(missed**2, axis=1), nan=math.inf)
        there = at(begun[int(np.argmin(powers))])
        if there.power < NEARER * best.power:
            there, _ = search(there, every)
            if there.power < MOVES * best.power:
                best = there
    x = best.state[:n]
    kept = system.kept(inputs[0], x)
    z = np.clip(best.state[n:], kept[:, 0], kept[:, 1])
    return Start(x, z, kept - z[:, None])


@dataclass(frozen=True)
class _At:
    """A state with what it misses, and the sum of squares of that, infinite if it diverged."""

    state: FloatArray
    missed: FloatArray
    power: float
