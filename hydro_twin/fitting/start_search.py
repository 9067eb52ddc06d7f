"""The search for the states at which runs over several parts start, side by side.

By damped steps of least squares [Levenberg 1944] for each part by itself, under the whole model.
"""
from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled
from hydro_twin.predictors.sensitivities import run_parts_with_slopes
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import NONE, tangent_of

MOVES = 0.5             # of the mean square missed: less is left where a run starts otherwise
NEARER = 0.9            # of the mean square missed: more is left by the last step of a search
NEAR = 0.05             # of the movement: a start that misses less is not on a wrong side
STEPS = 8               # of a search
SHORTEST = 4            # samples for each state, fewer of which are not searched by themselves
HELD = 0.01             # cost of a deviation from rest, over that of as large an output
DAMPED = (HELD, 0.3, 10.0)      # and of one from the last step
SINGULAR = 1e-12        # of the trace of normal equations, added to their diagonal


class StartSearch:
    """The search for the states of P parts and what the effects keep there, c coordinates each.

    States that the output does not show stay near rest: a deviation costs as if the output were
    measured to one per cent.

    Args:
        system: the model, as it is at the start.
        inputs: (P, N, m).
        measured: the output, (P, N).
        lengths: how many of these samples are of each part, (P,).
        sizes: movement of the output that is worth following, (P,).
    """

    def __init__(self, system: System, inputs: FloatArray, measured: FloatArray,
                 lengths: IntArray, sizes: FloatArray) -> None:
        self.system, self.tangent = system, tangent_of(system, NONE)
        self.inputs, self.measured = inputs, np.ascontiguousarray(measured)
        self.lengths, self.sizes, self.every = lengths, sizes, np.arange(len(lengths))
        rest = system.at_rest(inputs[:, 0], measured[:, 0])
        self.n, (P, N) = rest.shape[1], measured.shape
        self.kept = system.kept(inputs[:, 0], rest)
        self.rest = np.hstack([rest, np.zeros((P, system.memory))])
        response = system.free_response(N)
        shown = np.sqrt(np.cumsum(response**2, axis=0)[lengths - 1] / lengths[:, None])
        self.scale = np.hstack([sizes[:, None] / np.where(shown > 0.0, shown, 1.0),
                                self.kept[..., 1] - self.kept[..., 0]])
        self.linear = np.hstack([response, np.zeros((N, system.memory))])
        self.state = self.rest.copy()
        self.missed, self.power = np.zeros((P, N)), np.empty(P)
        self.columns = np.zeros((P, N, self.scale.shape[1]))

    def states(self) -> FloatArray:
        """Search from rest, and where much is missed from other states, too; returns (P, c).

        Where a mass turns back, its friction does, too: no step leads there from a start from
        which it turns at another time. Before that the search is easy. Where a gap may stand on
        either side, a search ends at any; and what a play holds is zero in it.
        """
        if len(self.system.step.effects) == 0:
            self.set_out(self.every, self.lengths)
            self.step(self.every, self.lengths, HELD, 1.0)
            return self.state
        self.search(self.every, self.lengths, self.n)
        self.from_fewer_samples(self.far(self.every, self.lengths))
        self.from_other_sides(self.far(self.every, self.lengths))
        return self.state

    def far(self, parts: IntArray, counts: IntArray) -> IntArray:
        """List those of some parts of which much is missed in so many samples."""
        found: IntArray = parts[
            self.power[parts] > (NEAR * self.sizes[parts])**2 * counts[parts]]
        return found

    def from_fewer_samples(self, parts: IntArray) -> None:
        """Search again by half of the samples, and if need be by half of those, and so on.

        Then from the states that these show, by twice as many, up to all of them. Where that
        leaves less, it counts.
        """
        state, missed, power = self.state[parts], self.missed[parts], self.power[parts]
        counts, depths = [self.lengths], np.zeros(len(self.lengths), dtype=np.int64)
        far = parts
        while len(far):
            counts.append((counts[-1] + 1) // 2)
            far = far[counts[-1][far] >= SHORTEST * self.n]
            depths[far] += 1
            self.state[far] = self.rest[far]
            self.search(far, counts[-1], self.n)
            far = self.far(far, counts[-1])
        for depth in range(len(counts) - 2, -1, -1):
            self.search(parts[depths[parts] > depth], counts[depth], self.n)
        back = ~(self.power[parts] < power)
        worse = parts[back]
        self.state[worse], self.missed[worse], self.power[worse] = (
            state[back], missed[back], power[back])

    def from_other_sides(self, parts: IntArray) -> None:
        """Search from where a gap stands on another side, with what is kept as a coordinate.

        One step leads from each side, by the derivatives at hand, and a search from the best,
        which counts if it leaves little of what is missed there.
        """
        if not len(parts):
            return
        before, power = self.state[parts], self.power[parts]
        begun, which = self.sides(parts)
        here = parts[which]
        missed, _ = self.at(begun, here, self.lengths)
        begun += self.scale[here] * self.explained(missed, here, self.lengths, HELD)[0]
        missed, powers = self.at(begun, here, self.lengths)
        # The best side of each part: the first of its rows, sorted by part and by power.
        order = np.lexsort((powers, which))
        best = order[np.unique(which[order], return_index=True)[1]]
        best = best[powers[best] < NEARER * power[which[best]]]
        nearer, power = here[best], powers[best]
        self.state[nearer] = begun[best]
        self.search(nearer, self.lengths, self.scale.shape[1])
        back = ~(self.power[nearer] < MOVES * power)
        self.state[nearer[back]] = before[which[best[back]]]

    def sides(self, parts: IntArray) -> tuple[FloatArray, IntArray]:
        """Return other starts of K parts (S, c), and of which part each is (S,)."""
        starts, which = [], []
        for i, unit in enumerate(np.eye(self.scale.shape[1])):
            scale = self.scale[parts, i]
            if i < self.n:
                values = [self.state[parts, i] + way * scale for way in (-1.0, 1.0)]
            else:
                low, high = self.kept[parts, i - self.n].T
                values = [low, high, 0.5 * (low + high)]
            moves = np.flatnonzero(scale)
            for value in values:
                starts.append(np.where(unit > 0.0, value[:, None], self.state[parts])[moves])
                which.append(moves)
        return np.concatenate(starts), np.concatenate(which)

    def search(self, parts: IntArray, counts: IntArray, free: int) -> None:
        """Search by so many samples along the first free coordinates, from the states of parts.

        Leaves the derivatives before the last step.
        """
        if not len(parts):
            return
        self.set_out(parts, counts)
        # What sticks at rest has no derivative there: first by the linear laws, if it moves.
        self.step(parts, counts, HELD, MOVES)
        for _ in range(STEPS):
            if not len(parts):
                break
            self.differentiate(parts, counts, free)
            moved = np.zeros(len(parts), dtype=bool)
            for held in DAMPED:
                moved[~moved] = self.step(parts[~moved], counts, held, NEARER)
            parts = parts[moved]

    def set_out(self, parts: IntArray, counts: IntArray) -> None:
        """Run from the states of parts, with the derivatives of the linear laws."""
        self.take(parts, *self.at(self.state[parts], parts, counts))
        self.columns[parts] = self.linear * self.scale[parts, None]

    def at(self, states: FloatArray, parts: IntArray, counts: IntArray
           ) -> tuple[FloatArray, FloatArray]:
        """Say what runs from K states miss of parts, (K, N), and the sum of squares of that."""
        longest = int(counts[parts].max(initial=0))
        missed = self.system.run_each(self.inputs, parts, states, longest)
        power = np.empty(len(parts))
        miss_each(self.measured, parts, counts, missed, power)
        return missed, power

    def take(self, parts: IntArray, missed: FloatArray, power: FloatArray) -> None:
        """Keep what the runs from the states of parts miss."""
        self.missed[parts, :missed.shape[1]] = missed
        self.power[parts] = power

    def differentiate(self, parts: IntArray, counts: IntArray, free: int) -> None:
        """Run from the states of parts with derivatives by the first free coordinates."""
        state, N = self.state[parts], int(counts[parts].max())
        _, slopes = run_parts_with_slopes(
            self.system, NONE, (self.tangent,),
            self.inputs[parts, :N].reshape(-1, self.inputs.shape[2]),
            N * np.arange(len(parts) + 1), state[:, :self.n], state[:, self.n:])
        reach = np.where(np.arange(state.shape[1]) < free, self.scale[parts], 0.0)
        self.columns[parts, :N] = slopes.reshape(len(parts), N, -1) * reach[:, None]

    def step(self, parts: IntArray, counts: IntArray, held: float, enough: float
             ) -> npt.NDArray[np.bool_]:
        """Move the states of parts where that leaves little enough; says which were moved."""
        moves, predicted = self.explained(self.missed[parts], parts, counts, held)
        moved = predicted < enough * self.power[parts]
        tried = parts[moved]
        states = self.state[tried] + self.scale[tried] * moves[moved]
        missed, power = self.at(states, tried, counts)
        better = power < enough * self.power[tried]
        self.state[tried[better]] = states[better]
        self.take(tried[better], missed[better], power[better])
        moved[moved] = better
        return moved

    def explained(self, missed: FloatArray, parts: IntArray, counts: IntArray, held: float
                  ) -> tuple[FloatArray, FloatArray]:
        """Return the coordinates that explain what is missed of K parts, and what that leaves.

        Damped by `held`; (K, c), and (K,) sums of squares. Nothing explains a run that diverged.
        """
        c = self.scale.shape[1]
        moves, power = np.empty((len(parts), c)), np.empty(len(parts))
        explain_each(self.columns, parts, missed, counts, (held * self.sizes)**2,
                     np.empty((c, c + 1)), moves, power)
        return moves, power


@compiled
def miss_each(measured, parts, counts, y, power):  # type: ignore[no-untyped-def]
    """Turn outputs y (K, N) of runs over parts into what they miss of measured (P, N).

    Fill power (K,) with the sum of squares over so many samples of the part, (P,).
    """
    for k in range(len(parts)):
        part, total = parts[k], 0.0
        for i in range(counts[part]):
            y[k, i] = measured[part, i] - y[k, i]
            total += y[k, i] * y[k, i]
        power[k] = total if total < np.inf else np.inf


@compiled
def explain_each(  # type: ignore[no-untyped-def]
        columns, parts, missed, counts, ridges, normal, moves, power):
    """Solve damped least squares for each of K parts: columns (P, N, c) times moves (K, c).

    Against missed (K, N), over so many samples of the part (P,); power (K,) is what that leaves.
    The normal equations and their right side are in normal (c, c + 1).
    """
    c = columns.shape[2]
    for k in range(len(parts)):
        part = parts[k]
        rows, count, left = columns[part], counts[part], missed[k]
        for a in range(c):
            moves[k, a] = 0.0
            for b in range(c + 1):
                normal[a, b] = 0.0
        for i in range(count):
            for a in range(c):
                normal[a, c] += rows[i, a] * left[i]
                for b in range(a + 1):
                    normal[a, b] += rows[i, a] * rows[i, b]
        trace, finite = 0.0, True
        for a in range(c):
            trace += normal[a, a]
            finite = finite and abs(normal[a, c]) < np.inf
        if finite and trace < np.inf:
            solve(normal, max(ridges[part] + SINGULAR * trace, 1e-300), moves[k])
        power[k] = 0.0
        for i in range(count):
            rest = left[i]
            for a in range(c):
                rest -= rows[i, a] * moves[k, a]
            power[k] += rest * rest


@compiled
def solve(normal, ridge, found):  # type: ignore[no-untyped-def]
    """Solve (c, c + 1) equations, symmetric and given below the diagonal, by Cholesky's factor.

    With a ridge on the diagonal, which bounds what rounding may leave of it.
    """
    c = len(normal)
    for a in range(c):
        normal[a, a] += ridge
        for b in range(a + 1):
            for j in range(b):
                normal[a, b] -= normal[a, j] * normal[b, j]
            if b < a:
                normal[a, b] /= normal[b, b]
        normal[a, a] = np.sqrt(max(normal[a, a], ridge))
        found[a] = normal[a, c]
        for b in range(a):
            found[a] -= normal[a, b] * found[b]
        found[a] /= normal[a, a]
    for a in range(c - 1, -1, -1):
        for b in range(a + 1, c):
            found[a] -= normal[b, a] * found[b]
        found[a] /= normal[a, a]
