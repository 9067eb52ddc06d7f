"""The states at which runs start, as the first samples of each part show them.

All parts are searched at once: each step of the search is one call of compiled code.
"""
from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from hydro_twin.fitting.start import Start
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.sensitivities import run_parts_with_slopes
from hydro_twin.predictors.system import IntArray, System
from hydro_twin.predictors.tangents import NONE, tangent_of

MOVES = 0.5             # of the mean square missed: less is left where a run starts otherwise
NEARER = 0.9            # of the mean square missed: more is left by the last step of a search
NEAR = 0.05             # of the movement: a start that misses less is not on a wrong side
NO_WORSE = 1.2          # RMS missed over that of a like model: no reason to search anew
STEPS = 8               # of that search
HELD = 0.01             # cost of a deviation from rest, over that of as large an output
DAMPED = (HELD, 0.3, 10.0)      # and of one from the last step


def find_starts(system: System, inputs: Sequence[FloatArray], measured: Sequence[FloatArray],
                least: Sequence[float], near: Sequence[Start | None]) -> list[Start]:
    """Find the state of each part from which the output is least missed.

    The one given, if not much more is missed from there than before. Else from rest, by a search
    with damped steps [Levenberg 1944], under the whole model. States that the output does not show
    stay near rest: a deviation costs as if the output were measured to one per cent. Where a gap
    may stand on either side, a search ends at any; and what a play holds is zero in it. So, where
    much is missed, it starts again from other sides, with what is kept as one more coordinate.

    Args:
        system: the model, as it is at the start.
        inputs: of the first samples of each part, (N, m) or shorter.
        measured: the output there.
        least: movement of the output of each that is worth following, above zero.
        near: starts that were found for a model that differs little, or None.
    """
    sizes = np.array([max(rms(one - one.mean()), floor)
                      for one, floor in zip(measured, least, strict=True)])
    found = dict(_near(system, inputs, measured, sizes, near))
    others = [k for k in range(len(inputs)) if k not in found]
    if others:
        states = _Search(system, [inputs[k] for k in others], [measured[k] for k in others],
                         sizes[others]).states()
        n = len(system.laws.A)
        found |= {k: _within_edges(system, inputs[k], measured[k], state[:n], state[n:])
                  for k, state in zip(others, states, strict=True)}
    return [found[k] for k in range(len(inputs))]


def _near(system: System, inputs: Sequence[FloatArray], measured: Sequence[FloatArray],
          sizes: FloatArray, near: Sequence[Start | None]) -> Iterator[tuple[int, Start]]:
    """Yield the starts that do here, and of which part each is."""
    for k, start in enumerate(near):
        if start is not None and len(start.z) == system.memory:
            here = _within_edges(system, inputs[k], measured[k], start.x, start.z)
            if here.missed < max(NO_WORSE * start.missed, NEAR * sizes[k]):
                yield k, here


def _within_edges(system: System, inputs: FloatArray, measured: FloatArray, x: FloatArray,
                  z: FloatArray) -> Start:
    """Return a start of a run, what the effects keep moved to within its edges."""
    kept = system.kept(inputs[0], x)
    z = np.clip(z, kept[:, 0], kept[:, 1])
    return Start(x, z, kept - z[:, None], rms(measured - system.run(inputs, x, z)))


class _Search:
    """The search for the states of some parts; arguments as of `find_starts`.

    Parts are padded to the longest. What is beyond their own samples counts for nothing.
    """

    def __init__(self, system: System, inputs: Sequence[FloatArray],
                 measured: Sequence[FloatArray], sizes: FloatArray) -> None:
        lengths = np.array([len(one) for one in measured])
        longest = int(lengths.max())
        self.system, self.tangent = system, tangent_of(system, NONE)
        response = system.free_response(longest)
        every = np.arange(longest)
        self.own = every < lengths[:, None]
        self.inputs, self.measured = (
            np.stack([one[np.minimum(every, len(one) - 1)] for one in some])
            for some in (inputs, measured))
        self.sizes, self.every = sizes, np.arange(len(sizes))
        rest = np.stack([system.start(one[0], y[0])
                         for one, y in zip(inputs, measured, strict=True)])
        self.kept = np.stack([system.kept(one[0], x)
                              for one, x in zip(inputs, rest, strict=True)])
        self.width = self.kept[..., 1] - self.kept[..., 0]
        shown = np.sqrt(np.cumsum(response**2, axis=0)[lengths - 1] / lengths[:, None])
        self.scale = np.hstack([sizes[:, None] / np.where(shown > 0.0, shown, 1.0), self.width])
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
        lengths = self.own.sum(axis=1)
        far = np.flatnonzero(self.power > (NEAR * self.sizes) ** 2 * lengths)
        before, power = self.state.copy(), self.power.copy()
        nearer = np.array([k for k in far.tolist() if self.other_side(k, columns[k])],
                          dtype=np.int64)
        self.search(nearer, np.ones(self.scale.shape[1], dtype=bool))
        back = nearer[~(self.power[nearer] < MOVES * power[nearer])]
        self.state[back] = before[back]
        return self.state

    def at(self, states: FloatArray, parts: IntArray) -> tuple[FloatArray, FloatArray]:
        """Say what runs from states of parts miss, (K, N), and the sum of squares of that."""
        y = self.system.run_each(self.inputs, parts, states)
        missed = np.where(self.own[parts], self.measured[parts] - y, 0.0)
        power = np.einsum('kn,kn->k', missed, missed)
        return missed, np.where(np.isfinite(power), power, np.inf)

    def slopes(self, parts: IntArray) -> FloatArray:
        """Return the derivatives of the outputs of parts by their coordinates, (K, N, c)."""
        states = self.state[parts]
        runs = run_parts_with_slopes(
            self.system, NONE, (self.tangent,), list(self.inputs[parts]), list(states[:, :self.n]),
            list(states[:, self.n:]), [None] * len(parts))
        found = np.stack([slopes[0] for _, slopes in runs])
        return np.where(self.own[parts][..., None], found, 0.0) * self.scale[parts][:, None]

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
        # What sticks at rest has no derivative there: first by the linear laws, if it moves.
        self.step(parts, self.linear[parts], HELD, MOVES)
        last = self.linear.copy()
        for _ in range(STEPS):
            if not len(parts):
                break
            last[parts] = np.where(free, self.slopes(parts), 0.0)
            waiting = parts
            for held in DAMPED:
                waiting = np.setdiff1d(waiting, self.step(waiting, last[waiting], held, NEARER))
            parts = np.setdiff1d(parts, waiting)
        return last

    def other_side(self, k: int, columns: FloatArray) -> bool:
        """Start a part from where a gap stands on another side, if that is nearer."""
        state, units = self.state[k], np.diag(self.scale[k])
        sides = [state + side * unit for unit in units[:self.n] for side in (-1.0, 1.0)]
        for i in np.flatnonzero(self.width[k]):
            sides += [np.where(np.arange(len(state)) == self.n + i, value, state)
                      for value in (*self.kept[k, i], self.kept[k, i].mean())]
        begun, here = np.array(sides), np.full(len(sides), k)
        missed, _ = self.at(begun, here)
        begun += self.scale[k] * self.explained(
            np.nan_to_num(missed), np.repeat(columns[None], len(sides), axis=0), HELD, here)
        missed, powers = self.at(begun, here)
        best = int(np.argmin(powers))
        if not powers[best] < NEARER * self.power[k]:
            return False
        self.state[k], self.missed[k], self.power[k] = begun[best], missed[best], powers[best]
        return True
