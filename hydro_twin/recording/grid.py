"""Puts signals on one time grid: commands held, measurements interpolated, gaps cut out."""
from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.recording.bag import Samples
from hydro_twin.recording.jitter import remove_jitter
from hydro_twin.recording.series import Series

MAX_GAP = 5.0   # sample times, or periods of a slower signal, that a pause may last
MIN_SAMPLES = 10   # shorter stretches hold nothing to learn from
FEWEST_STEADY = 20   # pauses, to show that a command is sent at a rate
FEWEST = 2   # samples of a sensor, to draw a line through
# Sample times between two samples of a sensor that is interpolated: jitter makes some of one at
# the rate of the grid longer than 1, a lost sample makes it 2.
BETWEEN = 1.5
STEADY_SHARE = 0.9   # of the pauses of a command within half a period: it is sent at a rate
SLACK = 0.1   # of a sample time: a held signal without stamps may be this late
ROUNDING = 1e-3   # of a sample time: one with stamps, which may come from rounded numbers


def to_grid(signals: Mapping[str, Samples], held: Collection[str], sample_time: float,
            source: str = '') -> list[Series]:
    """Resample signals on a common grid t0 + k sample_time.

    t0 is the first time at which all signals are known: the latest of their first stamps. A live
    node that follows the same rule and holds its commands sees the same samples. Stamps that lie
    on the grid give their samples unchanged; a command stamped up to a rounding error after a
    grid time counts at that time.

    Args:
        signals: name -> samples as recorded.
        held: the signals that keep their value until the next (commands).
        sample_time: distance of the samples [s].
        source: what the series say that they come from.

    Returns:
        One series for each uninterrupted stretch, in order; none where the stretches are too
        short.
    """
    step = sample_time * 1e9
    times = {name: samples.stamps if samples.stamped else remove_jitter(samples.stamps)
             for name, samples in signals.items()}
    begin, end = _common(
        [_stretches(times[name], step, name in held) for name in signals])
    series = []
    for start, stop in zip(begin, end, strict=True):
        count = int((stop - start + 0.5) // step) + 1   # stamps are rounded to whole ns
        if count < MIN_SAMPLES:
            continue
        grid = start + np.rint(step * np.arange(count)).astype(np.int64)
        columns = {}
        for name, samples in signals.items():
            if name in held:
                slack = round((ROUNDING if samples.stamped else SLACK) * step)
                columns[name] = hold(times[name], samples.values, grid + slack)
            else:
                columns[name] = interpolate(times[name], samples.values, grid)
        series.append(Series(columns, sample_time, int(start), source))
    return series


def beside(series: Series, samples: Samples) -> FloatArray:
    """Put a sensor on the grid of a series, at its own rate: nan between its samples.

    Between two samples no further apart than `BETWEEN` it is interpolated. Otherwise each sample
    counts at the grid time nearest to it, to which it is moved along the line through it and the
    sample before. So a fast sensor is known at every grid time, a slow one once a sample, and one
    that fails, or begins late, not at all meanwhile. No sample counts before it has come, so that
    a live node knows as much (`live.sensor`).

    Args:
        series: on a grid.
        samples: as recorded.

    Returns:
        Shape (N,).
    """
    step = series.sample_time * 1e9
    times = samples.stamps if samples.stamped else remove_jitter(samples.stamps)
    values = np.full(len(series), np.nan)
    if len(times) < FEWEST:
        return values
    grid = series.stamps
    after = np.searchsorted(times, grid)
    first, last = after == 0, after == len(times)
    after[last] -= 1
    later = np.maximum(after, 1)
    until_next = times[after] - grid
    interpolated = ~first & ~last & ((times[later] - times[later - 1] <= BETWEEN * step)
                                     | (until_next <= 0.5 * step))
    nearest = ~interpolated & (after + last >= 2) & (
        grid - times[after + last - 1] < 0.5 * step)
    later = np.where(nearest, after + last - 1, later)
    known = interpolated | nearest | (until_next == 0)
    values[known] = along(times, samples.values, grid[known], later[known])
    return values


def hold(times: IntArray, values: FloatArray, grid: IntArray) -> FloatArray:
    """Take at each grid time the last value before or at it."""
    return values[np.searchsorted(times, grid, side='right') - 1]


def interpolate(times: IntArray, values: FloatArray, grid: IntArray) -> FloatArray:
    """Interpolate linearly; a time on the grid gives its own value, to the last bit."""
    return along(times, values, grid, np.clip(np.searchsorted(times, grid), 1, len(times) - 1))


def along(times: IntArray, values: FloatArray, grid: IntArray, after: IntArray) -> FloatArray:
    """Go along the lines through samples `after` and those before them, one for each grid time."""
    before = after - 1
    weight = (grid - times[before]) / (times[after] - times[before])
    between = values[before] + weight * (values[after] - values[before])
    exact = np.where(weight == 0.0, values[before], values[after])
    return np.where((weight == 0.0) | (weight == 1.0), exact, between)


def _stretches(times: IntArray, step: float, is_held: bool) -> tuple[IntArray, IntArray]:
    """Find the first and last times of the stretches without a gap."""
    pauses = np.diff(times)
    typical = _typical(pauses)
    period = max(typical, step)
    steady = len(pauses) >= FEWEST_STEADY and (
        np.mean(np.abs(pauses - typical) <= 0.5 * period) >= STEADY_SHARE)
    gaps = np.flatnonzero(pauses > MAX_GAP * period)
    if is_held and not steady:   # sent when it changes: it is known however long it rests
        gaps = gaps[:0]
    begin = times[np.concatenate([[0], gaps + 1])]
    end = times[np.concatenate([gaps, [len(times) - 1]])]
    if is_held:   # the last command of a stretch holds for a while
        end = end + (round(MAX_GAP * period) if steady else 2**62 - end)
    return begin, end


def _typical(pauses: IntArray) -> float:
    """Take the median of the pauses between samples, 0 where there is none."""
    return float(np.median(pauses)) if len(pauses) else 0.0


def _common(stretches: list[tuple[IntArray, IntArray]]) -> tuple[IntArray, IntArray]:
    """Intersect the stretches of all signals."""
    begin, end = stretches[0]
    for begin_b, end_b in stretches[1:]:
        pairs = [(max(a, b), min(c, d)) for a, c in zip(begin, end, strict=True)
                 for b, d in zip(begin_b, end_b, strict=True) if max(a, b) <= min(c, d)]
        begin = np.array([pair[0] for pair in pairs], np.int64)
        end = np.array([pair[1] for pair in pairs], np.int64)
    return begin, end
