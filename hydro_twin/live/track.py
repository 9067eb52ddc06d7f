"""One signal as it comes in live: its newest samples, its pace, and what was wrong with others."""
from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from dataclasses import dataclass, field
import math

from hydro_twin.recording.grid import MAX_GAP, STEADY_SHARE

JUMP = 500_000_000   # a leap of stamps that no hiccup of a network explains [ns]
BACKLOG = 4096       # samples that a signal may be ahead of the others
PACE = 64            # pauses from which the pace is taken
TELLING = 4          # pauses that tell whether a command comes at a rate
OUTPUT = -1          # index of the output, which no prediction has to wait for for ever
SENSOR = -2          # of what is measured beside it

Sample = tuple[int, float]


@dataclass(eq=False)
class Track:
    """The newest samples of one signal.

    Attributes:
        index: of the input that it is, `OUTPUT` or `SENSOR`.
        sample_time: of the grid [ns].
        held: keeps its value until the next sample (a command); else interpolated.
        before: the newest sample that is not after the grid time.
        after: the samples after that.
        newest: stamp of the newest sample [ns].
        awaited: False from a fill-in to the next sample.
        period: typical pause, at least the sample time [ns].
        rests: comes when it changes, so that a pause says nothing.
        samples: how many came, whatever was wrong with them.
        duplicates, reordered: how many had the stamp of the newest one, or an older stamp.
        not_finite: how many were nan or infinite.
        late: how many came after their grid time was made.
        filled: how many grid times were made without one, as it did not come in time.
        needed: whether it is an input, without which no sample is made.
        longest_gap: pause that ends a series [ns].
    """

    name: str
    index: int
    held: bool
    sample_time: float
    before: Sample | None = None
    after: deque[Sample] = field(default_factory=deque)
    newest: int = -1
    awaited: bool = True
    period: float = 0.0
    rests: bool = False
    samples: int = 0
    duplicates: int = 0
    reordered: int = 0
    not_finite: int = 0
    late: int = 0
    filled: int = 0

    def __post_init__(self) -> None:
        self.needed = self.index >= 0
        self._pauses: list[int] = []
        self._next_pace = 1
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self.before = None
        self.after.clear()
        self.newest = -1
        self.awaited = True
        self.period = self.sample_time
        self.longest_gap = math.inf if self.held else MAX_GAP * self.period
        self.rests = False
        self._pauses.clear()
        self._next_pace = 1

    @property
    def resting(self) -> bool:
        """Whether a pause says nothing, or nothing yet."""
        return self.held and (self.rests or math.isinf(self.longest_gap))

    def first(self) -> int | None:
        """Return the stamp from which the signal is known."""
        if self.before is not None:
            return self.before[0]
        return self.after[0][0] if self.after else None

    def take(self, stamp: int, value: float) -> bool:
        """Take in a sample, or count what is wrong with it.

        Returns:
            Whether it is of use.
        """
        self.samples += 1
        pause = stamp - self.newest
        if pause <= 0:
            self.duplicates += pause == 0
            self.reordered += pause < 0
            return False
        if not math.isfinite(value):
            self.not_finite += 1
            return False
        if self.newest >= 0:
            self._pauses.append(pause)
            if len(self._pauses) == self._next_pace:
                self._learn_pace()
        self.newest = stamp
        self.awaited = True
        self.after.append((stamp, value))
        if len(self.after) > BACKLOG:
            self.before = self.after.popleft()
        return True

    def _learn_pace(self) -> None:
        """Take the pace from the pauses, as `recording.grid` does."""
        # Without numpy, whose calls would make one message in PACE wait for 0.1 ms.
        pauses = sorted(self._pauses)
        middle = len(pauses) // 2
        typical = (pauses[middle] + pauses[~middle]) / 2   # the median
        self.period = max(typical, self.sample_time)
        self.longest_gap = MAX_GAP * self.period
        near = 0.5 * self.period
        steady = (bisect_right(pauses, typical + near) - bisect_left(pauses, typical - near)
                  >= STEADY_SHARE * len(pauses))
        self.rests = self.held and len(pauses) >= TELLING and not steady
        if self._next_pace < PACE:
            self._next_pace *= 2
        else:
            self._pauses.clear()

    def breaks(self, due: int) -> bool:
        """Say whether a gap ends the series before a grid time, and if so forget what was before.

        A command holds for as long as a gap may last, a measurement needs a sample after it.
        """
        if self.before is None or self.rests:
            return False
        until = self.after[0][0] if self.after and not self.held else due
        if until - self.before[0] <= self.longest_gap:
            return False
        self.before = None
        return True
