"""The initial states of several parts, searched by their first samples under the whole model."""
from __future__ import annotations

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.first_samples import FirstSamples
from hydro_twin.fitting.initial_state_descent import First, NEAR, room_for, runs_of, search_each
from hydro_twin.fitting.initial_states import InitialStates
from hydro_twin.predictors.sensitivities import run_with_sensitivities
from hydro_twin.predictors.system import BEYOND, System
from hydro_twin.predictors.tangents import NONE, tangent_of

NO_WORSE = 1.2          # RMS residual over that of a similar model: no reason to search again
REACH = 3.0             # initial opening, over the largest asked for in the recording: a larger
#                         one may have been asked for before, and effects amplify
AS_GOOD = 1.02          # the same after a search from its state: the minimum is the same


def find_initial_states(system: System, first: FirstSamples, near: InitialStates | None = None,
                        warm_start: bool = True) -> InitialStates:
    """Find the initial state of each part that leaves the least residual.

    Args:
        system: the model, as it is at the beginning of the parts.
        first: the first samples of the parts.
        near: initial states under a similar model. One that does not fit much worse than it did
            is taken. The others are searched afresh, see `InitialStateSearch`.
        warm_start: whether to search from these first, and afresh only what then fits worse.
    """
    if near is None or near.z.shape[1] != system.memory:
        search = InitialStateSearch(system, first)
        return _within_edges(system, first, search.from_rest(np.arange(len(first.sizes))))
    states = np.hstack([near.x, near.z])
    found = _within_edges(system, first, states)
    most = np.maximum(NO_WORSE * near.rms, NEAR * first.sizes)
    others = np.flatnonzero(~(found.rms < most))
    if not len(others):
        return found
    some, left = first.at(others), np.arange(len(others))
    search = InitialStateSearch(system, some)
    if warm_start:
        found = found.with_others(others, _within_edges(
            system, some, search.from_states(left, states[others])))
        most = np.maximum(AS_GOOD * near.rms, NEAR * first.sizes)
        left = np.flatnonzero(~(found.rms < most)[others])
    if len(left):
        afresh, others = _within_edges(system, some.at(left), search.from_rest(left)), others[left]
        better = np.flatnonzero(~(afresh.rms > found.rms[others]))
        found = found.with_others(others[better], afresh.at(better))
    return found


def _within_edges(system: System, first: FirstSamples, states: FloatArray) -> InitialStates:
    """Run from states (P, c), moved to within what they can be."""
    n, limits = len(system.laws.A), REACH * system.commanded(first.largest)
    x = np.clip(states[:, :n], -limits, limits)
    edges = system.memory_edges(first.inputs[:, 0], x)
    z = np.clip(states[:, n:], edges[..., 0], edges[..., 1])
    P, N = first.measured.shape
    y = system.run_parts(first.inputs.reshape(P * N, -1), N * np.arange(P + 1), x, z).reshape(P, N)
    residual = np.where(first.own, first.measured - y, 0.0)
    margins = np.concatenate([np.stack([-limits - x, limits - x], axis=-1), edges - z[..., None]],
                             axis=1)
    return InitialStates(x, z, margins, np.sqrt(
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
        self.tangent, self.system = tangent_of(system, NONE), system
        rest = system.at_rest(first.inputs[:, 0], first.measured[:, 0])
        (P, N), n, counts = first.measured.shape, rest.shape[1], first.counts
        edges = system.memory_edges(first.inputs[:, 0], rest)
        response = system.free_response(N)
        shown = np.sqrt(np.cumsum(response**2, axis=0)[counts - 1] / counts[:, None])
        scale = np.hstack([first.sizes[:, None] / np.where(shown > 0.0, shown, 1.0),
                           edges[..., 1] - edges[..., 0]])
        swings = n + np.flatnonzero((edges[..., 1] == BEYOND).all(axis=0))
        free = np.arange(scale.shape[1]) < n
        free[swings] = True
        rest = np.hstack([rest, np.zeros((P, system.memory))])
        if len(swings):
            shown = self.shown(first, rest, n)[:, swings]
            scale[:, swings] = np.divide(first.sizes[:, None], shown, out=np.zeros(shown.shape),
                                         where=shown > 0.0)
        self.first = First(
            first.inputs, np.ascontiguousarray(first.measured), counts, first.sizes, rest, scale,
            edges, np.hstack([response, np.zeros((N, system.memory))]), free,
            np.ones(len(free), dtype=bool))

    def shown(self, first: FirstSamples, states: FloatArray, n: int) -> FloatArray:
        """RMS of the derivatives of the output by states (P, c), over the first samples."""
        P, N = first.measured.shape
        _, slopes = run_with_sensitivities(
            self.system, NONE, (self.tangent,), first.inputs.reshape(P * N, -1),
            N * np.arange(P + 1), states[:, :n], states[:, n:])
        squares = np.where(first.own[..., None], slopes.reshape(P, N, -1)**2, 0.0)
        found: FloatArray = np.sqrt(squares.sum(axis=1) / first.counts[:, None])
        return found

    def from_rest(self, parts: IntArray) -> FloatArray:
        """Search the states of some parts, first from rest; see `search`."""
        return self.searched(parts, self.first.rest[parts], True)

    def from_states(self, parts: IntArray, states: FloatArray) -> FloatArray:
        """Search the states of some parts from given ones alone."""
        return self.searched(parts, states, False)

    def searched(self, parts: IntArray, states: FloatArray, afresh: bool) -> FloatArray:
        """Return the states of K parts, (K, c), see `search_each`."""
        samples, found = int(self.first.counts[parts].max()), states.copy()
        search_each(runs_of(self.system, self.tangent, samples), self.first,
                    room_for(samples, found.shape[1]), parts, found, afresh)
        return found
