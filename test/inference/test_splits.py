"""Which part is held out: one that moves as the rest does."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.inference.splits import held_out_split, second_split
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series

T = 0.02


def moving(*speeds, seconds=20.0):
    """Move at one speed after the other, each for so long."""
    return Series({'x': T * np.cumsum(np.repeat(speeds, round(seconds / T)))}, T)


def there_and_back():
    return moving(*[1.0, -1.0] * 15, seconds=2.0)


@pytest.mark.parametrize(('series', 'expected'), [
    ([there_and_back()], 'third'),
    ([moving(0.0, 1.0, -1.0)], 'windows'),              # it stands in the first third
    ([moving(1.0, 1.0, -1.0, -1.0)], 'windows'),        # it only rises there
    ([moving(1.0, 1.0, -1.0, -1.0)] * 3, 'series'),
    ([moving(1.0), moving(-1.0)], 'third'),             # nothing else is better
])
def test_an_axis_is_tested_where_it_moves_as_in_the_rest(series, expected):
    (train, test), found = held_out_split(Recording(tuple(series)), plant_named('cylinder'))
    assert found == expected
    held_out = sum(map(len, test.series))
    assert held_out + sum(map(len, train.series)) == sum(map(len, series))


@pytest.mark.parametrize(('series', 'expected'), [
    (1, 'third'),                 # there are no windows where the plant forgets
    (3, 'series')])
def test_a_plant_that_forgets_is_tested_where_it_moves_as_in_the_rest(series, expected):
    opening = Series({'opening': moving(0.0, 1.0, -1.0)['x']}, T)
    (_, test), found = held_out_split(Recording((opening,) * series), plant_named('control_valve'))
    assert found == expected
    assert (np.ptp(test.series[0]['opening']) > 0.0) == (expected == 'series')


@pytest.mark.parametrize(('seconds', 'enough'), [(1.0, False), (20.0, True)])
def test_a_second_split_needs_sixths_that_can_be_scored(seconds, enough):
    recording = Recording((moving(1.0, seconds=seconds),))
    assert (second_split(recording, plant_named('cylinder')) is not None) == enough


@pytest.mark.parametrize(('series', 'expected'), [
    ([there_and_back()] * 3, 'series'),
    ([there_and_back()] * 2, 'sixth'),
    ([there_and_back(), moving(0.0, 0.0), there_and_back()], 'sixth')])   # the second one stands
def test_a_second_split_holds_out_series_that_move_as_the_others(series, expected):
    parts = second_split(Recording(tuple(series)), plant_named('cylinder'))
    assert parts is not None
    assert parts[1] == expected
