from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
import hypothesis.extra.numpy as hnp
import numpy as np
import pytest

from hydro_twin.recording.bag import Samples
from hydro_twin.recording.grid import beside, hold, interpolate, MAX_GAP, MIN_SAMPLES, to_grid

DT = 0.002
STEP = 2_000_000
FINITE = st.floats(-1e12, 1e12)


def samples(stamps, values=None, stamped=True):
    stamps = np.asarray(stamps, np.int64)
    return Samples(stamps, np.arange(len(stamps), dtype=float) if values is None
                   else np.asarray(values, float), stamped)


@given(values=hnp.arrays(float, st.integers(MIN_SAMPLES, 60), elements=FINITE),
       start=st.integers(0, 2 * 10**18), step=st.sampled_from([DT, 0.001, 1 / 300, 1 / 1024]))
def test_stamps_on_the_grid_pass_unchanged(values, start, step):
    stamps = start + np.rint(np.arange(len(values)) * step * 1e9).astype(np.int64)
    (series,) = to_grid({'u': samples(stamps, values), 'y': samples(stamps, -values)}, ['u'], step)
    assert series.start == start
    assert series['u'].tobytes() == values.tobytes()
    assert series['y'].tobytes() == (-values).tobytes()


@given(seed=st.integers(0, 2**32 - 1))
def test_commands_a_rounding_error_off_the_grid_are_on_it(seed):
    off = np.random.default_rng(seed).integers(-1, 2, 60)
    off[0] = 0
    stamps = 10**18 + STEP * np.arange(60)
    (series,) = to_grid({'u': samples(stamps + off), 'y': samples(stamps)}, ['u'], DT)
    assert series['u'].tolist() == list(range(60))


@st.composite
def scattered(draw, least=2, most=40):
    steps = draw(st.lists(st.integers(1, 4 * STEP), min_size=least, max_size=most))
    values = draw(hnp.arrays(float, len(steps), elements=FINITE))
    return np.cumsum(steps), values


@given(record=scattered(), shares=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
def test_hold_takes_the_last_value_and_interpolate_agrees_with_numpy(record, shares):
    times, values = record
    grid = np.sort([times[0] + round(s * (times[-1] - times[0])) for s in shares])
    expected = [max((t, v) for t, v in zip(times, values, strict=True) if t <= g)[1] for g in grid]
    assert hold(times, values, grid).tolist() == expected
    scale = np.abs(values).max()
    np.testing.assert_allclose(interpolate(times, values, grid), np.interp(grid, times, values),
                               rtol=0, atol=1e-12 * scale + 1e-300)


@given(offset=st.integers(0, STEP), slope=st.floats(-1e3, 1e3),
       period=st.integers(STEP // 4, 3 * STEP))
def test_a_straight_line_stays_one_at_any_rate(offset, slope, period):
    """Linear interpolation of a ramp is exact, whatever the rate of the signal."""
    stamps = offset + period * np.arange(100)
    (series,) = to_grid({'y': samples(stamps, slope * stamps * 1e-9)}, [], DT)
    time = (series.start + STEP * np.arange(len(series))) * 1e-9
    np.testing.assert_allclose(series['y'], slope * time, rtol=1e-9, atol=1e-9)


@given(cuts=st.lists(st.tuples(st.integers(20, 480), st.integers(1, 30)), max_size=4))
def test_long_gaps_split_and_short_ones_are_bridged(cuts):
    """Against a search sample by sample: no grid point lies in a gap, none outside is lost."""
    kept = np.ones(500, bool)
    for begin, length in cuts:
        kept[begin:begin + length] = False
    numbers = np.flatnonzero(kept)
    u = samples(STEP * np.arange(500))
    series = to_grid({'u': u, 'y': samples(STEP * numbers, numbers)}, ['u'], DT)
    expected = [[int(numbers[0])]]
    for before, after in pairwise(numbers):
        if after - before > MAX_GAP:
            expected.append([])
            before = after - 1
        expected[-1] += range(before + 1, after + 1)
    expected = [stretch for stretch in expected if len(stretch) >= MIN_SAMPLES]
    assert [s.start // STEP for s in series] == [stretch[0] for stretch in expected]
    for found, stretch in zip(series, expected, strict=True):
        np.testing.assert_allclose(found['y'], stretch, rtol=1e-12)
        assert found['u'].tolist() == stretch


def test_series_begin_where_all_signals_are_known():
    series = to_grid({'u': samples(STEP * np.arange(5, 100)),
                      'y': samples(STEP * np.arange(2, 90) + 700_000)}, ['u'], DT)
    assert [s.start for s in series] == [5 * STEP]
    assert len(series[0]) == 89 + 1 - 5
    assert series[0]['y'][0] == pytest.approx(3 - 0.35)


def test_a_command_sent_when_it_changes_is_held_however_long():
    u = samples([0, 700 * STEP, 710 * STEP, 1800 * STEP], [1.0, 2.0, 3.0, 4.0])
    (series,) = to_grid({'u': u, 'y': samples(STEP * np.arange(3000))}, ['u'], DT)
    assert len(series) == 3000
    assert np.flatnonzero(np.diff(series['u'])).tolist() == [699, 709, 1799]


def test_a_command_sent_once_is_held_to_the_end():
    u = samples([40 * STEP], [7.0])
    (series,) = to_grid({'u': u, 'y': samples(STEP * np.arange(3000))}, ['u'], DT)
    assert series.start == 40 * STEP
    assert series['u'].tolist() == [7.0] * 2960


def test_a_stream_of_commands_that_stops_is_not_invented():
    u = samples(STEP * np.concatenate([np.arange(200), np.arange(400, 600)]))
    found = to_grid({'u': u, 'y': samples(STEP * np.arange(600))}, ['u'], DT)
    assert [s.start // STEP for s in found] == [0, 400]
    assert len(found[0]) == 200 + MAX_GAP


def test_signals_of_different_rates_share_the_grid():
    (series,) = to_grid({'u': samples(5 * STEP * np.arange(40)),
                         'y': samples(STEP // 2 * np.arange(800))}, ['u'], DT)
    assert len(series) == 196 + 5 * MAX_GAP   # the last command is held as long as a gap may be
    assert series['u'].tolist() == [min(k // 5, 39) for k in range(len(series))]
    assert series['y'].tolist() == [2 * k for k in range(len(series))]


def grid_of(n):
    return to_grid({'u': samples(STEP * np.arange(n)), 'y': samples(STEP * np.arange(n))}, ['u'],
                   DT)[0]


@pytest.mark.parametrize('phase', [0, 3, 8])
def test_a_slow_sensor_counts_once_a_sample_and_is_not_made_up_between(phase):
    """At the grid time nearest to it, before or after."""
    stamps = 10 * STEP * np.arange(10) + phase * STEP // 10
    found = beside(grid_of(101), samples(stamps, 2e-9 * stamps))
    there = np.flatnonzero(np.isfinite(found))
    first = 0 if phase == 0 else 10         # off the grid, a line through two is needed
    assert there.tolist() == list(range(first + (phase > 5), 100, 10))
    np.testing.assert_allclose(found[there], 2.0 * DT * there, rtol=1e-12)


def test_a_sensor_at_the_rate_of_the_grid_is_known_everywhere_whatever_its_jitter():
    rng = np.random.default_rng(0)
    stamps = STEP * np.arange(101) + rng.integers(0, STEP // 5, 101)
    found = beside(grid_of(101), samples(stamps, 1e-9 * stamps))
    np.testing.assert_allclose(found[1:], DT * np.arange(1, 101), rtol=1e-12)


def test_a_fast_sensor_is_known_everywhere():
    stamps = STEP // 4 * np.arange(401)
    found = beside(grid_of(101), samples(stamps, 1e-9 * stamps))
    np.testing.assert_allclose(found, DT * np.arange(101), atol=1e-15)


@pytest.mark.parametrize('rate', [STEP // 2, STEP, 4 * STEP])
def test_a_sensor_that_fails_and_comes_back_is_missing_meanwhile_and_splits_nothing(rate):
    stamps = np.arange(0, 400 * STEP, rate)
    stamps = stamps[(stamps < 100 * STEP) | (stamps > 300 * STEP)]
    series = grid_of(400)
    found = beside(series, samples(stamps))
    assert len(found) == len(series) == 400
    assert np.isnan(found[101:300]).all()
    per = max(rate // STEP, 1)
    assert np.isfinite(found[:100:per]).all()
    assert np.isfinite(found[300 + per:396:per]).all()


def test_one_sample_of_a_sensor_says_nothing():
    assert np.isnan(beside(grid_of(20), samples([5 * STEP]))).all()
