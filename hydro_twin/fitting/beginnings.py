"""The states at which runs start, as the first samples of each part show them.

All parts are searched at once: each step of the search is one call of compiled code.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.start import Starts
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.sensitivities import run_parts_with_slopes
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import NONE, tangent_of

MOVES = 0.5             # of the mean square missed: less is left where a run starts otherwise
NEARER = 0.9            # of the mean square missed: more is left by the last step of a search
NEAR = 0.05             # of the movement: a start that misses less is not on a wrong side
NO_WORSE = 1.2          # RMS missed over that of a like model: no reason to search anew
STEPS = 8               # of that search
SHORTEST = 4            # samples for each state, fewer of which are not searched by themselves
HELD = 0.01             # cost of a deviation from rest, over that of as large an output
DAMPED = (HELD, 0.3, 10.0)      # and of one from the last step
LEAST = 1e-3            # of the size of the output: movement that is worth following


@dataclass(frozen=True)
class Beginnings:
    """The first samples of P parts, side by side; those of shorter ones go on as they end.

    Attributes:
        inputs: (P, N, m).
        measured: the output, (P, N).
        own: which of the samples are of the part, (P, N).
        sizes: movement of the output of each that is worth following, RMS, above zero, (P,).
    """

    inputs: FloatArray
    measured: FloatArray
    own: npt.NDArray[np.bool_]
    sizes: FloatArray

    @property
    def lengths(self) -> IntArray:
        """How many samples are of each part, (P,)."""
        found: IntArray = self.own.sum(axis=1)
        return found

    @classmethod
    def of(cls, parts: Sequence[Part], start_up: int) -> Beginnings:
        """Take as many samples of each part as show the state at its start."""
        lengths = np.array([part.beginning(start_up) for part in parts])
        every = np.arange(lengths.max())
        taken = np.minimum(every, lengths[:, None] - 1)
        measured = np.stack([part.measured[rows] for part, rows in zip(parts, taken, strict=True)])
        return cls(
            np.stack([part.inputs[rows] for part, rows in zip(parts, taken, strict=True)]),
            measured, every < lengths[:, None],
            np.array([max(rms(one[:n] - one[:n].mean()), LEAST * part.size, 1e-12)
                      for part, one, n in zip(parts, measured, lengths.tolist(), strict=True)]))

    def at(self, parts: IntArray) -> Beginnings:
        """Take those of some parts."""
        own = self.own[parts]
        longest = int(own.sum(axis=1).max())
        return Beginnings(self.inputs[parts, :longest], self.measured[parts, :longest],
                          own[:, :longest], self.sizes[parts])

    def first_half(self) -> Beginnings:
        """Take the first half of the samples of each part."""
        n = (self.own.shape[1] + 1) // 2
        own = np.arange(n) < (self.lengths[:, None] + 1) // 2
        return Beginnings(self.inputs[:, :n], self.measured[:, :n], own, self.sizes)


def find_starts(system: System, beginnings: Beginnings, near: Starts | None = None) -> Starts:
    """Find the state of each part from which the output is least missed.

    The one given, if not much more is missed from there than before. Else from rest, by a search
    with damped steps [Levenberg 1944], under the whole model. States that the output does not show
    stay near rest: a deviation costs as if the output were measured to one per cent. Where a gap
    may stand on either side, a search ends at any; and what a play holds is zero in it. So, where
    much is missed, it starts again from other sides, with what is kept as one more coordinate.

    Args:
        system: the model, as it is at the start.
        beginnings: the first samples of the parts.
        near: starts that were found for a model that differs little.
    """
    others = np.arange(len(beginnings.sizes))
    found = None
    if near is not None and near.z.shape[1] == system.memory:
        found = _within_edges(system, beginnings, near.x, near.z)
        others = np.flatnonzero(~(found.missed < np.maximum(
            NO_WORSE * near.missed, NEAR * beginnings.sizes)))
        if not len(others):
            return found
    these = beginnings if found is None else beginnings.at(others)
    states, n = _Search(system, these).states(), len(system.laws.A)
    anew = _within_edges(system, these, states[:, :n], states[:, n:])
    return anew if found is None else found.with_others(others, anew)


def _within_edges(system: System, beginnings: Beginnings, x: FloatArray, z: FloatArray) -> Starts:
    """Return starts of runs, what the effects keep moved to within its edges."""
    kept = system.kept(beginnings.inputs[:, 0], x)
    z = np.clip(z, kept[..., 0], kept[..., 1])
    y = system.run_each(beginnings.inputs, np.arange(len(x)), np.hstack([x, z]))
    missed = np.where(beginnings.own, beginnings.measured - y, 0.0)
    return Starts(x, z, kept - z[..., None], np.sqrt(
        np.einsum('kn,kn->k', missed, missed) / beginnings.own.sum(axis=1)))


class _Search:
    """The search for the states of some parts; arguments as of `find_starts`.

    Parts are padded to the longest. What is beyond their own samples counts for nothing.
    """

    def __init__(self, system: System, beginnings: Beginnings) -> None:
        self.system, self.tangent, self.beginnings = system, tangent_of(system, NONE), beginnings
        self.inputs, self.measured = beginnings.inputs, beginnings.measured
        self.own, self.sizes = beginnings.own, beginnings.sizes
        lengths = beginnings.lengths
        response = system.free_response(self.own.shape[1])
        self.every = np.arange(len(self.sizes))
        rest = system.at_rest(self.inputs[:, 0], self.measured[:, 0])
        self.kept = system.kept(self.inputs[:, 0], rest)
        self.width = self.kept[..., 1] - self.kept[..., 0]
        shown = np.sqrt(np.cumsum(response**2, axis=0)[lengths - 1] / lengths[:, None])
        self.scale = np.hstack([self.sizes[:, None] / np.where(shown > 0.0, shown, 1.0),
                                self.width])
        self.n = rest.shape[1]
        self.linear = np.zeros((*self.own.shape, self.scale.shape[1]))
        self.linear[..., :self.n] = (np.where(self.own[..., None], response, 0.0)
                                     * self.scale[:, None, :self.n])
        self.state = np.hstack([rest, np.zeros(self.width.shape)])
        self.missed, self.power = self.at(self.state, self.every)

    def states(self) -> FloatArray:
        """Search, and return the states with what effects keep, (P, n + memory)."""
        if len(self.system.step.effects) == 0:
            self.step(self.every, self.linear, HELD, 1.0)
            return self.state
        columns = self.search(self.every, np.arange(self.scale.shape[1]) < self.n)
        far = self.far()
        if len(far) and self.own.shape[1] >= 2 * SHORTEST * self.n:
            self.from_first_half(far, columns)
            far = self.far()
        before, power = self.state.copy(), self.power.copy()
        nearer = self.other_side(far, columns[far])
        self.search(nearer, np.ones(self.scale.shape[1], dtype=bool))
        back = nearer[~(self.power[nearer] < MOVES * power[nearer])]
        self.state[back] = before[back]
        return self.state

    def far(self) -> IntArray:
        """List the parts of which much is missed."""
        return np.flatnonzero(
            self.power > (NEAR * self.sizes) ** 2 * self.beginnings.lengths)

    def from_first_half(self, far: IntArray, columns: FloatArray) -> None:
        """Search again from the states that fewer samples show, where that leaves less.

        Where a mass turns back, its friction does, too: no step leads there from a start from
        which it turns elsewhere. Before that the search is easy.
        """
        before, missed, power = self.state[far], self.missed[far], self.power[far]
        shorter = self.beginnings.at(far).first_half()
        self.state[far] = _Search(self.system, shorter).states()
        self.missed[far], self.power[far] = self.at(self.state[far], far)
        columns[far] = self.search(far, np.arange(self.scale.shape[1]) < self.n)[far]
        worse = ~(self.power[far] < power)
        back = far[worse]
        self.state[back], self.missed[back], self.power[back] = (
            before[worse], missed[worse], power[worse])

    def at(self, states: FloatArray, parts: IntArray) -> tuple[FloatArray, FloatArray]:
        """Say what runs from states of parts miss, (K, N), and the sum of squares of that."""
        y = self.system.run_each(self.inputs, parts, states)
        missed = np.where(self.own[parts], self.measured[parts] - y, 0.0)
        power = np.einsum('kn,kn->k', missed, missed)
        return missed, np.where(np.isfinite(power), power, np.inf)

    def slopes(self, parts: IntArray) -> FloatArray:
        """Return the derivatives of the outputs of parts by their coordinates, (K, N, c)."""
        states, (_, N, m) = self.state[parts], self.inputs.shape
        _, slopes = run_parts_with_slopes(
            self.system, NONE, (self.tangent,), self.inputs[parts].reshape(-1, m),
            N * np.arange(len(parts) + 1), states[:, :self.n], states[:, self.n:])
        return (np.where(self.own[parts][..., None], slopes.reshape(len(parts), N, -1), 0.0)
                * self.scale[parts][:, None])

    def explained(self, missed: FloatArray, columns: FloatArray, held: float, parts: IntArray
                  ) -> FloatArray:
        """Return the coordinates that explain what outputs miss, (K, c)."""
        finite = np.isfinite(columns).all(axis=(1, 2)) & np.isfinite(missed).all(axis=1)
        columns = np.where(finite[:, None, None], columns, 0.0)
        missed = np.where(finite[:, None], missed, 0.0)
        normal = columns.transpose(0, 2, 1) @ columns
        ridge = ((held * self.sizes[parts]) ** 2
                 + 1e-12 * np.trace(normal, axis1=1, axis2=2))
        normal += np.maximum(ridge, 1e-300)[:, None, None] * np.eye(columns.shape[2])
        right = columns.transpose(0, 2, 1) @ missed[..., None]
        found: FloatArray = np.linalg.solve(normal, right)[..., 0]
        return found

    def step(self, parts: IntArray, columns: FloatArray, held: float, enough: float) -> IntArray:
        """Move the states of parts where that leaves little enough; returns which it moved."""
        missed, power = self.missed[parts], self.power[parts]
        moved = self.explained(missed, columns, held, parts)
        predicted = missed - (columns @ moved[..., None])[..., 0]
        good = np.isfinite(power) & (np.einsum('kn,kn->k', predicted, predicted) < enough * power)
        tried: IntArray = parts[good]
        if not len(tried):
            return tried
        states = self.state[tried] + self.scale[tried] * moved[good]
        left, powers = self.at(states, tried)
        better = powers < enough * self.power[tried]
        took: IntArray = tried[better]
        self.state[took], self.missed[took] = states[better], left[better]
        self.power[took] = powers[better]
        return took

    def search(self, parts: IntArray, free: npt.NDArray[np.bool_]) -> FloatArray:
        """Search from the states of parts along free coordinates.

        Returns:
            The derivatives at the end, of all parts, (P, N, c).
        """
        last = self.linear.copy()
        if not len(parts):
            return last
        # What sticks at rest has no derivative there: first by the linear laws, if it moves.
        self.step(parts, self.linear[parts], HELD, MOVES)
        for _ in range(STEPS):
            if not len(parts):
                break
            last[parts] = np.where(free, self.slopes(parts), 0.0)
            waiting = parts
            for held in DAMPED:
                waiting = np.setdiff1d(waiting, self.step(waiting, last[waiting], held, NEARER))
            parts = np.setdiff1d(parts, waiting)
        return last

    def other_side(self, far: IntArray, columns: FloatArray) -> IntArray:
        """Start parts from where a gap stands on another side; returns which are nearer then."""
        if not len(far):
            return far
        state, scale = self.state[far, None], self.scale[far, None]
        units = np.eye(scale.shape[-1])
        sides = [state + way * scale * unit for unit in units[:self.n] for way in (-1.0, 1.0)]
        theirs = [np.ones(len(far), dtype=bool)] * len(sides)
        for i in range(self.width.shape[1]):
            low, high = self.kept[far, i].T
            sides += [np.where(units[self.n + i] > 0.0, value[:, None, None], state)
                      for value in (low, high, 0.5 * (low + high))]
            theirs += [self.width[far, i] != 0.0] * 3
        which, side = np.nonzero(np.stack(theirs, axis=1))
        begun, here = np.concatenate(sides, axis=1)[which, side], far[which]
        missed, _ = self.at(begun, here)
        begun += self.scale[here] * self.explained(
            np.nan_to_num(missed), columns[which], HELD, here)
        missed, powers = self.at(begun, here)
        every = np.full((len(far), len(sides)), np.inf)
        every[which, side] = powers
        nearer = np.flatnonzero(every.min(axis=1) < NEARER * self.power[far])
        for k in nearer.tolist():
            row = int(np.flatnonzero((which == k) & (side == every[k].argmin()))[0])
            self.state[far[k]], self.missed[far[k]] = begun[row], missed[row]
            self.power[far[k]] = powers[row]
        moved: IntArray = far[nearer]
        return moved
