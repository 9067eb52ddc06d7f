"""A sensor beside the output as it comes in live, read at the times of the grid."""
from __future__ import annotations

from dataclasses import dataclass
import math

from hydro_twin.live.track import Sample, Track
from hydro_twin.recording.grid import BETWEEN


@dataclass(eq=False)
class Sensor(Track):
    """The newest samples of a sensor; `recording.grid.beside`, one grid time at a time.

    It is optional, so it neither begins nor ends a series, and nothing is held in its place.

    Attributes:
        earlier: the sample before `before`.
    """

    earlier: Sample | None = None

    def clear(self) -> None:
        """Forget all samples; one that is silent is not waited for after that either."""
        awaited = self.awaited
        super().clear()
        self.earlier, self.awaited = None, awaited

    @property
    def slow(self) -> bool:
        """Whether it counts at single grid times."""
        return self.period > BETWEEN * self.sample_time

    def counts_until(self, stamp: int) -> float:
        """Return the last grid time at which a sample of that stamp may count [ns]."""
        return stamp + 0.5 * self.sample_time if self.slow else stamp

    def reach(self, due: int) -> bool:
        """Step up to a grid time; return whether all that counts there has come, or is not due."""
        while self.after and self.after[0][0] <= due:
            self.earlier, self.before = self.before, self.after.popleft()
        if self.after or not self.awaited:
            return True
        if self.before is None:
            return False
        next_ = self.before[0] + self.period
        return self.before[0] == due or (self.slow and next_ > due + 0.5 * self.sample_time)

    def read(self, due: int) -> float:
        """Return what it reads at a grid time, after `reach`; nan where that is not known."""
        before, half = self.before, 0.5 * self.sample_time
        if before is None:
            return math.nan
        if before[0] == due:
            return before[1]
        if self.after:
            later = self.after[0]
            if (later[0] - before[0] <= BETWEEN * self.sample_time or later[0] - due <= half):
                return _along(before, later, due)
        if self.earlier is not None and due - before[0] < half:
            return _along(self.earlier, before, due)
        return math.nan


def _along(one: Sample, other: Sample, due: int) -> float:
    """Go along the line through two samples to a grid time."""
    return one[1] + (due - one[0]) / (other[0] - one[0]) * (other[1] - one[1])
