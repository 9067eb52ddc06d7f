"""What a recording is once it is read: uniform columns, in uninterrupted stretches."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray

OFTEN, EVER = 0.02, 0.002   # tail shares: frequent changes of one part, rare ones of the other
HALF = 0.5              # share of a frequent change in one part that the other part must reach


@dataclass(frozen=True)
class Series:
    """One uninterrupted stretch of samples on a uniform time grid.

    Attributes:
        columns: signal name -> samples, all of one length, in the units of the plant.
        sample_time: distance of two samples [s].
        start: stamp of the first sample [ns].
        source: the bag that it comes from, as the user named it.
        whole: the series that `split` cut it from; None if it was not cut.
        offset: samples of `whole` before its first.
    """

    columns: Mapping[str, FloatArray]
    sample_time: float
    start: int = 0
    source: str = ''
    whole: Series | None = None
    offset: int = 0

    def __len__(self) -> int:
        """Count the samples."""
        return len(next(iter(self.columns.values())))

    def __getitem__(self, signal: str) -> FloatArray:
        """Return the samples of one signal."""
        return self.columns[signal]

    def stacked(self, names: Sequence[str]) -> FloatArray:
        """Stack signals, (N, names); nan where the series has none of that name."""
        stack = np.full((len(self), len(names)), np.nan)
        for k, name in enumerate(names):
            if name in self.columns:
                stack[:, k] = self.columns[name]
        return stack

    @property
    def stamps(self) -> IntArray:
        """Stamps of all samples [ns]."""
        steps = np.arange(len(self)) * (self.sample_time * 1e9)
        return np.asarray(self.start + np.rint(steps).astype(np.int64))

    def part(self, begin: int, end: int) -> Series:
        """Cut out the samples begin <= k < end, as a series of its own."""
        return replace(
            self,
            columns={name: column[begin:end] for name, column in self.columns.items()},
            start=self.start + round(begin * self.sample_time * 1e9),
            whole=None, offset=0,
        )


@dataclass(frozen=True)
class StampedSeries:
    """One uninterrupted stretch of samples at times of their own, as a table has them.

    Attributes:
        columns: signal name -> samples, all of one length, in the units of the plant.
        stamps: of the samples, strictly increasing [ns].
        source: the table that it comes from.
    """

    columns: Mapping[str, FloatArray]
    stamps: IntArray
    source: str = ''

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.stamps)

    def __getitem__(self, signal: str) -> FloatArray:
        """Return the samples of one signal."""
        return self.columns[signal]


@dataclass(frozen=True)
class Source:
    """A file or bag that data came from, with what is needed to know it again."""

    path: str
    sha256: str


@dataclass(frozen=True)
class Recording:
    """All the series of one or several bags, in the order given."""

    series: tuple[Series, ...]
    sources: tuple[Source, ...] = ()

    @property
    def sample_time(self) -> float:
        """The clock of all its series [s]."""
        return self.series[0].sample_time

    def __add__(self, other: Recording) -> Recording:
        """Append the series of another recording."""
        return Recording(self.series + other.series, self.sources + other.sources)


def split(recording: Recording, nth: int = 3, skipped: int = 0) -> tuple[Recording, Recording]:
    """Split every series: one nth of it is the test part, the rest trains [B19: the first third].

    Args:
        recording: what is split.
        nth: in how many parts.
        skipped: how many of them come before the test part.

    Returns:
        (train, test); train has a series for what comes before the test part and one for what
        comes after it. Each knows the series that it is cut from, over which a run goes.
    """
    train, test = [], []
    for s in recording.series:
        begin, end = len(s) * skipped // nth, len(s) * (skipped + 1) // nth
        train += [_cut(s, 0, begin)] if begin else []
        train.append(_cut(s, end, len(s)))
        test.append(_cut(s, begin, end))
    return Recording(tuple(train), recording.sources), Recording(tuple(test), recording.sources)


def split_by_windows(recording: Recording, length: float) -> tuple[Recording, Recording]:
    """Cut every series into windows, and split off the second of every three; see `split`.

    Args:
        recording: what is split.
        length: of a window [s], at most.
    """
    train, test = [], []
    for s in recording.series:
        windows = max(math.ceil(len(s) * s.sample_time / length - 1e-9), 1)
        edges = [len(s) * k // windows for k in range(windows + 1)]
        held_out = list(zip(edges[1::3], edges[2::3], strict=False))
        test += [_cut(s, begin, end) for begin, end in held_out]
        ends = [0, *(edge for window in held_out for edge in window), len(s)]
        train += [_cut(s, begin, end) for begin, end in zip(ends[::2], ends[1::2], strict=True)
                  if end > begin]
    return Recording(tuple(train), recording.sources), Recording(tuple(test), recording.sources)


def _cut(s: Series, begin: int, end: int) -> Series:
    return replace(s.part(begin, end), whole=s, offset=begin)


def split_by_series(recording: Recording) -> tuple[Recording, Recording]:
    """Split off the second of every three series, whole; returns (train, test)."""
    train = tuple(s for k, s in enumerate(recording.series) if k % 3 != 1)
    test = recording.series[1::3]
    return Recording(train, recording.sources), Recording(test, recording.sources)


def moves_alike(one: Recording, other: Recording, signal: str, lag: float) -> bool:
    """Return whether a signal moves about as fast in two parts of a recording.

    So it does where changes as fast as the frequent ones of each part also occur, to at least
    half, in the other, in both directions.

    Args:
        one: a part of a recording.
        other: another.
        signal: its name.
        lag: over which changes are taken [s].
    """
    after = max(1, round(lag / one.sample_time))
    changes = [np.concatenate([s[signal][after:] - s[signal][:-after] for s in part.series
                               if len(s) > after] or [np.zeros(1)]) for part in (one, other)]
    often = [np.quantile(change, [OFTEN, 1.0 - OFTEN]) for change in changes]
    ever = [np.quantile(change, [EVER, 1.0 - EVER]) for change in changes]
    return all(min(low, 0.0) <= HALF * least and max(high, 0.0) >= HALF * most
               for (low, high), (least, most) in zip(ever, reversed(often), strict=True))
