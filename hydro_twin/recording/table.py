"""Reads tables (text, MAT, NPZ) as series, with stamps by a time column or a sample rate."""
from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
import logging
import math
from pathlib import Path

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.errors import BagError
from hydro_twin.recording.columns import load_columns
from hydro_twin.recording.grid import MAX_GAP
from hydro_twin.recording.series import StampedSeries
from hydro_twin.recording.table_map import TableMap

log = logging.getLogger(__name__)

START = 1_000_000_000   # stamp of the first sample [ns]: in ROS a stamp of zero means none
PAUSE = 10_000_000_000   # between two runs where it is not known [ns]
LONGEST = 2e9   # [s]: a stamp holds seconds in 32 bits
EVEN = 0.01   # of a period: a time column is off the line by rounding only, not by jitter


@dataclass(frozen=True)
class Last:
    """When the last row of a table was: by its stamp in the bag [ns], and by the table [s]."""

    stamp: int
    seconds: float


def read_tables(paths: Sequence[Path], table_map: TableMap, sensors: Collection[str] = (),
                done: Callable[[], None] = lambda: None) -> list[StampedSeries]:
    """Read tables as series, with the times of their rows as stamps.

    A new series begins where the `series` column changes, where the time goes back, and after a
    pause of more than MAX_GAP times the typical period. Of rows with the same time the first
    counts. Times that are even but for rounding (of the column, or of seconds since 1970 in
    floating point) are put on their line. Where a table begins after the end of the one before
    it, by the time column, the pause between them is kept, so that a drift goes on at its rate;
    but it is at least twice what would still be bridged.

    Args:
        paths: the tables.
        table_map: how to read them.
        sensors: signals that may be nan, where they were not measured.
        done: is called after each table.

    Raises:
        BagError: a table cannot be read, lacks a column, or holds what is not a number.
    """
    series: list[StampedSeries] = []
    last = None
    for path in paths:
        some, last = _read(path, table_map, last, sensors)
        series += some
        done()
    return series


def _read(path: Path, table_map: TableMap, after: Last | None, sensors: Collection[str]
          ) -> tuple[list[StampedSeries], Last]:
    """Read a table as series, and its last row."""
    entries = [*table_map.signals.values(), *([table_map.time] if table_map.time else [])]
    wanted = {name for entry in entries for name in entry.columns}
    if table_map.series:
        wanted.add(table_map.series)
    table = load_columns(path, wanted, table_map)
    count = max(map(len, table.values()))
    if any(len(column) not in (1, count) for column in table.values()):
        lengths = ', '.join(f'{name} {len(column)}' for name, column in table.items())
        raise BagError(f'{path}: columns of different lengths: {lengths}')
    table = {name: np.broadcast_to(column, count) for name, column in table.items()}
    rows = np.arange(count) + table_map.rows[0]

    if table_map.time is not None:
        _check_finite(path, {name: table[name] for name in table_map.time.columns}, rows)
    seconds = table_map.time.take(table) if table_map.time else _counted(table_map, rows)
    begin, end = table_map.time_range
    inside = (seconds >= begin) & (seconds <= end)
    if not inside.any():
        raise BagError(f'{path} has no rows between {begin:g} and {end:g} s; its times are '
                       f'{seconds.min():.9g} to {seconds.max():.9g} s')
    table, rows = {name: column[inside] for name, column in table.items()}, rows[inside]
    loose = {name for sensor in sensors if sensor in table_map.signals
             for name in table_map.signals[sensor].columns}
    needed = {name for signal, entry in table_map.signals.items() if signal not in sensors
              for name in entry.columns}
    _check_finite(path, {name: column for name, column in table.items()
                         if name not in loose - needed}, rows)

    time = _nanoseconds(path, table_map, table, rows)
    new_run = np.diff(time) < 0
    if table_map.series:
        new_run |= np.diff(table[table_map.series]) != 0
    kept = np.concatenate([[True], (np.diff(time) != 0) | new_run])
    if not kept.all():
        _report_repeated(path, rows[~kept], len(rows))
    table = {name: column[kept] for name, column in table.items()}
    columns = {name: entry.take(table) for name, entry in table_map.signals.items()}
    seconds = seconds[inside][kept]
    series = _cut(columns, time[kept], new_run[kept[1:]], str(path),
                  None if after is None else after.stamp, _pause(after, float(seconds[0])))
    return series, Last(int(series[-1].stamps[-1]), float(seconds[-1]))


def _pause(after: Last | None, begin: float) -> int:
    """Return the time from the last row to one at so many seconds [ns]; PAUSE if not known."""
    if after is None:
        return PAUSE
    pause = begin - after.seconds
    # Tables with clocks of their own may seem to follow each other by more than stamps can hold.
    return round(pause * 1e9) if 0.0 < pause < LONGEST - 1e-9 * after.stamp else PAUSE


def _counted(table_map: TableMap, rows: IntArray) -> FloatArray:
    """Return the times of rows that come at a rate [s]; the first of the table is at zero."""
    assert table_map.sample_time is not None   # a map has either
    return np.asarray((rows - 1) * table_map.sample_time, np.float64)


def _nanoseconds(path: Path, table_map: TableMap, table: Mapping[str, FloatArray], rows: IntArray,
                 ) -> IntArray:
    """Return the times since the first row [ns].

    The first is taken off before the unit is applied: nanoseconds since 1970 leave no digits.
    """
    time, factor = ((_counted(table_map, rows), 1.0) if table_map.time is None else
                    (table_map.time.product(table), table_map.time.factor))
    seconds = (time - time[0]) * factor
    if (longest := float(np.ptp(seconds))) > LONGEST:
        raise BagError(f'{path}: the times span {longest:.3g} s, more than stamps can: is the '
                       + ('unit of the time column right?' if table_map.time else
                          'sample_rate right?'))
    return np.asarray(np.rint((time - time[0]) * (factor * 1e9)), np.int64)


def _check_finite(path: Path, table: Mapping[str, FloatArray], rows: IntArray) -> None:
    """Refuse what is not a number."""
    for name, column in table.items():
        if not np.isfinite(column).all():
            raise BagError(f'{path}: column {name} is not a finite number in row '
                           f'{rows[np.argmin(np.isfinite(column))]}')


def _report_repeated(path: Path, repeated: IntArray, count: int) -> None:
    """Warn of rows with the time of the row before; refuse where that is no exception."""
    if 2 * len(repeated) >= count:
        raise BagError(f'{path}: {len(repeated)} of {count} rows have the time of the row before, '
                       f'the first is row {repeated[0]}: if that column is not the time, name '
                       "another; if it is too coarse, give 'sample_rate' in its place")
    log.warning('%s: %d rows with the time of the row before are left out, the first is row %d',
                path, len(repeated), repeated[0])


def _cut(columns: Mapping[str, FloatArray], time: IntArray, new_run: np.ndarray, source: str,
         after: int | None, pause: int) -> list[StampedSeries]:
    """Cut rows into series, and place the runs one after the other.

    Args:
        columns: signal -> values, shape (N,).
        time: of the rows [ns], shape (N,), strictly increasing within a run.
        new_run: whether a run begins with the second row, the third, ..., shape (N - 1,).
        source: what the series say that they come from.
        after: the last stamp of what comes before [ns].
        pause: since then [ns], at least; between two runs it is PAUSE.
    """
    steps = np.diff(time)
    periods = steps[~new_run]
    typical = float(np.median(periods)) if len(periods) else 0.0
    least = math.ceil(2 * MAX_GAP * typical)
    cut = new_run | (steps > MAX_GAP * typical)
    ends = [0, *(np.flatnonzero(cut) + 1).tolist(), len(time)]
    series: list[StampedSeries] = []
    offset = 0
    for begin, end in pairwise(ends):
        if begin == 0 or new_run[begin - 1]:
            offset = (START if after is None else after + max(pause, least)) - int(time[begin])
            pause = PAUSE
        stamps = _evened(time[begin:end] + offset)
        series.append(StampedSeries(
            {name: column[begin:end] for name, column in columns.items()}, stamps, source))
        after = int(stamps[-1])
    return series


def _evened(stamps: IntArray) -> IntArray:
    """Replace stamps by even ones, whole ns apart, if that moves none by over EVEN of a period."""
    if len(stamps) < 3:
        return stamps
    time = (stamps - stamps[0]).astype(np.float64)
    steps = np.diff(time)
    counts = np.concatenate([[0.0], np.cumsum(np.rint(steps / np.median(steps)))])
    if counts[-1] == 0.0:
        return stamps
    period = round(np.polyfit(counts, time, 1)[0])
    first = np.median(time - period * counts)
    line = np.rint(first + period * counts).astype(np.int64)
    even = np.abs(time - line).max() <= EVEN * period and (np.diff(line) > 0).all()
    return stamps[0] + line if even else stamps
