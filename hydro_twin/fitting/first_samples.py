"""The first samples of each part, which show its initial state."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.parts import Part
from hydro_twin.predictors.scores import rms

MIN_MOVEMENT = 1e-3     # of the size of the output: movement that is worth following


@dataclass(frozen=True)
class FirstSamples:
    """The first samples of P parts, side by side; shorter ones are continued by their last.

    Attributes:
        inputs: (P, N, m).
        measured: the output, (P, N).
        own: which of the samples are of the part, (P, N).
        sizes: movement of the output of each that is worth following, RMS, above zero, (P,).
        largest: magnitude of each input, in all that follows, too, (m,).
    """

    inputs: FloatArray
    measured: FloatArray
    own: npt.NDArray[np.bool_]
    sizes: FloatArray
    largest: FloatArray

    @property
    def counts(self) -> IntArray:
        """How many samples are of each part, (P,)."""
        found: IntArray = self.own.sum(axis=1)
        return found

    @classmethod
    def of(cls, parts: Sequence[Part], start_up: int) -> FirstSamples:
        """Take as many samples of each part as show its initial state."""
        counts = np.array([part.first_samples(start_up) for part in parts])
        every = np.arange(counts.max())
        taken = np.minimum(every, counts[:, None] - 1)
        measured = np.stack([part.measured[rows] for part, rows in zip(parts, taken, strict=True)])
        return cls(
            np.stack([part.inputs[rows] for part, rows in zip(parts, taken, strict=True)]),
            measured, every < counts[:, None],
            np.array([max(rms(one[:n] - one[:n].mean()), MIN_MOVEMENT * part.size, 1e-12)
                      for part, one, n in zip(parts, measured, counts.tolist(), strict=True)]),
            np.abs(np.concatenate([part.inputs for part in parts])).max(axis=0))

    def at(self, parts: IntArray) -> FirstSamples:
        """Take those of some parts."""
        own = self.own[parts]
        longest = int(own.sum(axis=1).max())
        return FirstSamples(self.inputs[parts, :longest], self.measured[parts, :longest],
                            own[:, :longest], self.sizes[parts], self.largest)
