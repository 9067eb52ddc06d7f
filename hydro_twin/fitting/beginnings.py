"""The states at which runs start, as the first samples of each part show them."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.start import Starts
from hydro_twin.fitting.start_search import NEAR, StartSearch
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.system import System

NO_WORSE = 1.2          # RMS missed over that of a like model: no reason to search anew
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


def find_starts(system: System, beginnings: Beginnings, near: Starts | None = None) -> Starts:
    """Find the state of each part from which the output is least missed.

    Args:
        system: the model, as it is at the start.
        beginnings: the first samples of the parts.
        near: starts that were found for a model that differs little. They do where not much more
            is missed than before; else the start is searched, see `StartSearch`.
    """
    others, found = np.arange(len(beginnings.sizes)), None
    if near is not None and near.z.shape[1] == system.memory:
        found = _within_edges(system, beginnings, np.hstack([near.x, near.z]))
        others = np.flatnonzero(~(found.missed < np.maximum(
            NO_WORSE * near.missed, NEAR * beginnings.sizes)))
        if not len(others):
            return found
    these = beginnings if found is None else beginnings.at(others)
    anew = _within_edges(system, these, StartSearch(
        system, these.inputs, these.measured, these.lengths, these.sizes).states())
    return anew if found is None else found.with_others(others, anew)


def _within_edges(system: System, beginnings: Beginnings, states: FloatArray) -> Starts:
    """Return starts of runs, what the effects keep moved to within its edges."""
    n = len(system.laws.A)
    x, kept = states[:, :n], system.kept(beginnings.inputs[:, 0], states[:, :n])
    z = np.clip(states[:, n:], kept[..., 0], kept[..., 1])
    y = system.run_each(beginnings.inputs, np.arange(len(x)), np.hstack([x, z]))
    missed = np.where(beginnings.own, beginnings.measured - y, 0.0)
    return Starts(x, z, kept - z[..., None], np.sqrt(
        np.einsum('kn,kn->k', missed, missed) / beginnings.lengths))
