"""The initial states of runs over several parts."""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class InitialStates:
    """The initial states of runs over P parts.

    Attributes:
        x: of the plant, (P, n).
        z: the memory of the effects, (P, memory).
        margins: by how much state and memory can change, down and up, (P, n + memory, 2): the
            follower of a play is somewhere between its edges.
        rms: of the residual over the first samples, (P,).
    """

    x: FloatArray
    z: FloatArray
    margins: FloatArray
    rms: FloatArray

    def __len__(self) -> int:
        return len(self.x)

    def at(self, parts: IntArray) -> InitialStates:
        """Take those of some parts."""
        return InitialStates(self.x[parts], self.z[parts], self.margins[parts], self.rms[parts])

    def moved(self, change: FloatArray) -> InitialStates:
        """Add a change of states and memory, (P, n + memory)."""
        n = self.x.shape[1]
        return replace(self, x=self.x + change[:, :n], z=self.z + change[:, n:],
                       margins=self.margins - change[..., None])

    def with_others(self, parts: IntArray, others: InitialStates) -> InitialStates:
        """Replace those of some parts."""
        copy = self.at(np.arange(len(self)))
        for values, new in ((copy.x, others.x), (copy.z, others.z),
                            (copy.margins, others.margins), (copy.rms, others.rms)):
            values[parts] = new
        return copy
