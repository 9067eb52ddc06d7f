"""What is held out: a third of every series, or every third series, or every third window."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.recording.series import (
    moves_alike,
    Recording,
    Series,
    split,
    split_by_series,
    split_by_windows,
)


def there_and_back(seconds=3.0, back=1.0):
    """Rise and fall in a ramp each, with noise."""
    time = np.arange(0.0, seconds, 0.01)
    rise = np.interp(time / seconds, [0.0, 0.3, 0.7, 1.0], [0.0, 1.0, 1.0, 1.0 - back])
    noise = 0.002 * np.random.default_rng(0).standard_normal(len(time))
    return Series({'x': rise + noise}, 0.01)


def test_every_third_series_is_held_out_whole():
    series = tuple(Series({'x': np.full(10, float(k))}, 0.01) for k in range(7))
    train, test = split_by_series(Recording(series))
    assert [s['x'][0] for s in train.series] == [0, 2, 3, 5, 6]
    assert [s['x'][0] for s in test.series] == [1, 4]


@pytest.mark.parametrize('samples', [90, 1000, 1999])
def test_every_third_window_is_held_out(samples):
    series = Series({'x': np.arange(float(samples))}, 0.01)
    train, test = split_by_windows(Recording((series,)), 1.0)
    assert [round(s['x'][0], -2) for s in test.series] == list(range(100, samples, 300))
    assert all(abs(len(s) - 100) <= 3 for s in test.series)
    pieces = sorted((*train.series, *test.series), key=lambda s: s.offset)
    assert np.array_equal(np.concatenate([s['x'] for s in pieces]), series['x'])
    assert all(s.offset == s['x'][0] and s.whole is series for s in pieces)


def test_a_first_third_that_only_rises_does_not_move_like_the_rest():
    recording = Recording(tuple(there_and_back(3.0 + k) for k in range(5)))
    assert not moves_alike(*split(recording), 'x', 0.1)
    assert moves_alike(*split_by_series(recording), 'x', 0.1)


@pytest.mark.parametrize('swapped', [False, True])
def test_neither_part_may_lack_what_the_other_often_shows(swapped):
    parts = Recording((there_and_back(),)), Recording((there_and_back(back=0.0),))
    assert not moves_alike(*(reversed(parts) if swapped else parts), 'x', 0.1)
    assert moves_alike(parts[0], parts[0], 'x', 0.1)
