"""The search for the initial states of several parts, by their first samples.

By Levenberg's method [Levenberg 1944], for all parts side by side, under the whole model.
"""
from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.compiled import compiled
from hydro_twin.fitting.first_samples import FirstSamples
from hydro_twin.fitting.initial_states import InitialStates
from hydro_twin.predictors.sensitivities import run_with_sensitivities
from hydro_twin.predictors.system import BEYOND, System
from hydro_twin.predictors.tangents import NONE, tangent_of

NO_WORSE = 1.2          # RMS residual over that of a similar model: no reason to search again
AS_GOOD = 1.02          # the same after a search from its state: the minimum is the same
HALVED = 0.5            # of the sum of squares: more is left where a search failed
LOWERED = 0.9           # of the sum of squares: more is left by the last step of a search
NEAR = 0.05             # of the movement: an RMS residual below it is that of the right branch
STEPS = 8               # of a search
SHORTEST = 4            # samples for each state: fewer are not searched by themselves
RIDGE = 0.01            # cost of a deviation from rest, over that of as large an output
RIDGES = (RIDGE, 0.3, 10.0)     # of the steps of a search, tried in this order
SINGULAR = 1e-12        # of the trace of normal equations, added to their diagonal


def find_initial_states(system: System, first: FirstSamples, near: InitialStates | None = None,
                        lead_on: bool = True) -> InitialStates:
    """Find the initial state of each part that leaves the least residual.

    Args:
        system: the model, as it is at the beginning of the parts.
        first: the first samples of the parts.
        near: initial states under a similar model. One that does not fit much worse than it did
            is taken. The others are searched afresh, see `InitialStateSearch`.
        lead_on: whether to search from these first, and afresh only what then fits worse.
    """
    if near is None or near.z.shape[1] != system.memory:
        return _within_edges(system, first, InitialStateSearch(system, first).search())
    states = np.hstack([near.x, near.z])
    found = _within_edges(system, first, states)
    most = np.maximum(NO_WORSE * near.rms, NEAR * first.sizes)
    others = np.flatnonzero(~(found.rms < most))
    if lead_on and len(others):
        some = first.at(others)
        ended = InitialStateSearch(system, some).search_from(states[others])
        found = found.with_others(others, _within_edges(system, some, ended))
        most = np.maximum(AS_GOOD * near.rms, NEAR * first.sizes)
        others = others[~(found.rms < most)[others]]
    if len(others):
        some = first.at(others)
        afresh = _within_edges(system, some, InitialStateSearch(system, some).search())
        better = np.flatnonzero(~(afresh.rms > found.rms[others]))
        found = found.with_others(others[better], afresh.at(better))
    return found


def _within_edges(system: System, first: FirstSamples, states: FloatArray) -> InitialStates:
    """Run from states (P, c), the memory of the effects moved to within its edges."""
    n = len(system.laws.A)
    x, edges = states[:, :n], system.memory_edges(first.inputs[:, 0], states[:, :n])
    z = np.clip(states[:, n:], edges[..., 0], edges[..., 1])
    y = system.run_each(first.inputs, np.arange(len(x)), np.hstack([x, z]))
    residual = np.where(first.own, first.measured - y, 0.0)
    return InitialStates(x, z, edges - z[..., None], np.sqrt(
        np.einsum('kn,kn->k', residual, residual) / first.counts))


class InitialStateSearch:
    """The search for the states of P parts and the memory of the effects, c coordinates each.

    States that the output does not show stay near rest: a ridge on the deviation from it acts as
    if the output were measured to one per cent.

    Args:
        system: the model, as it is at the beginning of the parts.
        first: the first samples of the parts.
    """

    def __init__(self, system: System, first: FirstSamples) -> None:
        self.system, self.tangent = system, tangent_of(system, NONE)
        self.inputs, self.measured = first.inputs, np.ascontiguousarray(first.measured)
        self.counts, self.sizes = first.counts, first.sizes
        rest = system.at_rest(first.inputs[:, 0], first.measured[:, 0])
        self.n, (P, N) = rest.shape[1], first.measured.shape
        self.edges = system.memory_edges(first.inputs[:, 0], rest)
        self.rest = np.hstack([rest, np.zeros((P, system.memory))])
        response = system.free_response(N)
        shown = np.sqrt(
            np.cumsum(response**2, axis=0)[self.counts - 1] / self.counts[:, None])
        self.scale = np.hstack([self.sizes[:, None] / np.where(shown > 0.0, shown, 1.0),
                                self.edges[..., 1] - self.edges[..., 0]])
        swings = self.n + np.flatnonzero((self.edges[..., 1] == BEYOND).all(axis=0))
        self.free = np.arange(self.scale.shape[1]) < self.n
        self.free[swings] = True
        self.linear = np.hstack([response, np.zeros((N, system.memory))])
        self.state = self.rest.copy()
        self.residual, self.squares = np.zeros((P, N)), np.empty(P)
        self.jacobian = np.zeros((P, N, self.scale.shape[1]))
        if len(swings):
            self.scale[:, swings] = 1.0
            self.differentiate(np.arange(P), self.counts, self.free)
            shown = np.sqrt(np.einsum('kic,kic->kc', self.jacobian, self.jacobian)
                            / self.counts[:, None])[:, swings]
            self.scale[:, swings] = np.divide(
                self.sizes[:, None], shown, out=np.zeros(shown.shape), where=shown > 0.0)

    def search(self) -> FloatArray:
        """Search from rest, and where that fits poorly from other states, too; returns (P, c).

        Where a mass reverses, its friction changes sign: no step leads there from a state from
        which it reverses at another time. With the samples before that, the search is easy. A gap
        may be entered from either side, and a search from one does not reach the other; nor does
        the output determine the memory of a play inside its gap.
        """
        every = np.arange(len(self.counts))
        if len(self.system.step.effects) == 0:
            self.run_linear(every, self.counts)
            self.step(every, self.counts, RIDGE, 1.0)
            return self.state
        self.descend(every, self.counts, self.free)
        self.from_fewer_samples(self.poor(every, self.counts))
        self.from_other_branches(self.poor(every, self.counts))
        return self.state

    def search_from(self, states: FloatArray) -> FloatArray:
        """Search from states (P, c) alone; returns (P, c)."""
        self.state = states.copy()
        self.descend(np.arange(len(self.counts)), self.counts, self.free)
        return self.state

    def poor(self, parts: IntArray, counts: IntArray) -> IntArray:
        """List those of some parts whose residual over so many samples is large."""
        found: IntArray = parts[
            self.squares[parts] > (NEAR * self.sizes[parts])**2 * counts[parts]]
        return found

    def from_fewer_samples(self, parts: IntArray) -> None:
        """Search by half of the samples, if need be by half of those, and so on.

        Then from the states found by twice as many, up to all of them. The result is taken where
        it lowers the sum of squares.
        """
        state, residual, squares = self.state[parts], self.residual[parts], self.squares[parts]
        counts, depths = [self.counts], np.zeros(len(self.counts), dtype=np.int64)
        poor = parts
        while len(poor):
            counts.append((counts[-1] + 1) // 2)
            poor = poor[counts[-1][poor] >= SHORTEST * self.n]
            depths[poor] += 1
            self.state[poor] = self.rest[poor]
            self.descend(poor, counts[-1], self.free)
            poor = self.poor(poor, counts[-1])
        for depth in range(len(counts) - 2, -1, -1):
            self.descend(parts[depths[parts] > depth], counts[depth], self.free)
        back = ~(self.squares[parts] < squares)
        worse = parts[back]
        self.state[worse], self.residual[worse], self.squares[worse] = (
            state[back], residual[back], squares[back])

    def from_other_branches(self, parts: IntArray) -> None:
        """Search from states on other sides of a gap, the memory being a coordinate, too.

        One step leads from each of these states, by the derivatives at hand, and a search from
        the best, which is taken if it lowers the sum of squares by much.
        """
        if not len(parts):
            return
        before, squares = self.state[parts], self.squares[parts]
        states, which = self.other_branches(parts)
        here = parts[which]
        residual, _ = self.run(states, here, self.counts)
        states += self.scale[here] * self.ridge_steps(residual, here, self.counts, RIDGE)[0]
        _, left = self.run(states, here, self.counts)
        # The best state of each part: the first of its rows, sorted by part and sum of squares.
        order = np.lexsort((left, which))
        best = order[np.unique(which[order], return_index=True)[1]]
        best = best[left[best] < LOWERED * squares[which[best]]]
        better, squares = here[best], left[best]
        self.state[better] = states[best]
        self.descend(better, self.counts, np.ones(self.scale.shape[1], dtype=bool))
        back = ~(self.squares[better] < HALVED * squares)
        self.state[better[back]] = before[which[best[back]]]

    def other_branches(self, parts: IntArray) -> tuple[FloatArray, IntArray]:
        """Return states of K parts on other branches (S, c), and of which part each is (S,)."""
        states, which = [], []
        for i, unit in enumerate(np.eye(self.scale.shape[1])):
            scale = self.scale[parts, i]
            if self.free[i]:
                values = [self.state[parts, i] + way * scale for way in (-1.0, 1.0)]
            else:
                low, high = self.edges[parts, i - self.n].T
                values = [low, high, 0.5 * (low + high)]
            moves = np.flatnonzero(scale)
            for value in values:
                states.append(np.where(unit > 0.0, value[:, None], self.state[parts])[moves])
                which.append(moves)
        return np.concatenate(states), np.concatenate(which)

    def descend(self, parts: IntArray, counts: IntArray, free: npt.NDArray[np.bool_]) -> None:
        """Search by so many samples along the free coordinates (c,), from the states of parts.

        Leaves the Jacobian before the last step.
        """
        if not len(parts):
            return
        self.run_linear(parts, counts)
        # What sticks at rest has no derivative there: first by the linear laws, if it moves.
        self.step(parts, counts, RIDGE, HALVED)
        for _ in range(STEPS):
            if not len(parts):
                break
            self.differentiate(parts, counts, free)
            moved = np.zeros(len(parts), dtype=bool)
            for ridge in RIDGES:
                moved[~moved] = self.step(parts[~moved], counts, ridge, LOWERED)
            parts = parts[moved]

    def run_linear(self, parts: IntArray, counts: IntArray) -> None:
        """Run from the states of parts, with the Jacobian of the linear laws."""
        self.keep(parts, *self.run(self.state[parts], parts, counts))
        self.jacobian[parts] = self.linear * self.scale[parts, None]

    def run(self, states: FloatArray, parts: IntArray, counts: IntArray
            ) -> tuple[FloatArray, FloatArray]:
        """Run from K states over parts; returns residuals (K, N), and their sums of squares."""
        longest = int(counts[parts].max(initial=0))
        residual = self.system.run_each(self.inputs, parts, states, longest)
        squares = np.empty(len(parts))
        to_residuals(self.measured, parts, counts, residual, squares)
        return residual, squares

    def keep(self, parts: IntArray, residual: FloatArray, squares: FloatArray) -> None:
        """Keep the residuals of the runs from the states of parts."""
        self.residual[parts, :residual.shape[1]] = residual
        self.squares[parts] = squares

    def differentiate(self, parts: IntArray, counts: IntArray, free: npt.NDArray[np.bool_]
                      ) -> None:
        """Run from the states of parts with derivatives by the free coordinates, (c,)."""
        state, N = self.state[parts], int(counts[parts].max())
        _, slopes = run_with_sensitivities(
            self.system, NONE, (self.tangent,),
            self.inputs[parts, :N].reshape(-1, self.inputs.shape[2]),
            N * np.arange(len(parts) + 1), state[:, :self.n], state[:, self.n:])
        units = np.where(free, self.scale[parts], 0.0)
        self.jacobian[parts, :N] = slopes.reshape(len(parts), N, -1) * units[:, None]

    def step(self, parts: IntArray, counts: IntArray, ridge: float, enough: float
             ) -> npt.NDArray[np.bool_]:
        """Step where that lowers the sum of squares to `enough` of it; says which parts moved."""
        steps, predicted = self.ridge_steps(self.residual[parts], parts, counts, ridge)
        moved = predicted < enough * self.squares[parts]
        tried = parts[moved]
        states = self.state[tried] + self.scale[tried] * steps[moved]
        residual, squares = self.run(states, tried, counts)
        better = squares < enough * self.squares[tried]
        self.state[tried[better]] = states[better]
        self.keep(tried[better], residual[better], squares[better])
        moved[moved] = better
        return moved

    def ridge_steps(self, residual: FloatArray, parts: IntArray, counts: IntArray, ridge: float
                    ) -> tuple[FloatArray, FloatArray]:
        """Return the steps of ridge regression for K parts, (K, c), and predicted squares, (K,).

        A run that diverged does not move.
        """
        c = self.scale.shape[1]
        steps, squares = np.empty((len(parts), c)), np.empty(len(parts))
        ridge_regressions(self.jacobian, parts, residual, counts, (ridge * self.sizes)**2,
                          np.empty((c, c + 1)), steps, squares)
        return steps, squares


@compiled
def to_residuals(measured, parts, counts, y, squares):  # type: ignore[no-untyped-def]
    """Turn outputs y (K, N) of runs over parts into residuals of measured (P, N).

    Fill squares (K,) with the sum of their squares over so many samples of the part, (P,).
    """
    for k in range(len(parts)):
        part, total = parts[k], 0.0
        for i in range(counts[part]):
            y[k, i] = measured[part, i] - y[k, i]
            total += y[k, i] * y[k, i]
        squares[k] = total if total < np.inf else np.inf


@compiled
def ridge_regressions(  # type: ignore[no-untyped-def]
        jacobian, parts, residual, counts, ridges, normal, steps, squares):
    """Regress the residual (K, N) of each of K parts on its columns of the Jacobian (P, N, c).

    Over so many samples of the part, with its ridge, (P,). Fill steps (K, c) and squares (K,),
    the sum of squares that is left. The normal equations and their right side are in normal
    (c, c + 1).
    """
    c = jacobian.shape[2]
    for k in range(len(parts)):
        part = parts[k]
        rows, count, left = jacobian[part], counts[part], residual[k]
        for a in range(c):
            steps[k, a] = 0.0
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
            solve_cholesky(normal, max(ridges[part] + SINGULAR * trace, 1e-300), steps[k])
        squares[k] = 0.0
        for i in range(count):
            rest = left[i]
            for a in range(c):
                rest -= rows[i, a] * steps[k, a]
            squares[k] += rest * rest


@compiled
def solve_cholesky(normal, ridge, found):  # type: ignore[no-untyped-def]
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
