"""Sensors beside the output, live: as the offline grid has them, and when they fail."""
from __future__ import annotations

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np

from hydro_twin.live.aligner import Aligner
from hydro_twin.live.sensor import Sensor
from hydro_twin.live.track import OUTPUT, SENSOR, Track
from hydro_twin.recording.bag import Samples
from hydro_twin.recording.grid import beside, to_grid

STEP = 2_000_000
START = 1_700_000_000_000_000_123
Event = tuple[int, str, float]


class Rig:
    """An aligner with a command, an output and one sensor of two that the plant has."""

    def __init__(self, wait: float = 10.0) -> None:
        self.sensor = Sensor('s', SENSOR, False, STEP)
        self.tracks: dict[str, Track] = {
            'u': Track('u', 0, True, STEP), 'y': Track('y', OUTPUT, False, STEP)}
        self.aligner = Aligner(tuple(self.tracks.values()), 0.002, wait, [None, self.sensor])
        self.tracks['s'] = self.sensor
        self.rows: list[tuple[int, float]] = []

    def take(self, stamp: int, name: str, value: float) -> None:
        self.aligner.push(self.tracks[name], stamp, value)
        while self.aligner.advance():
            assert math.isnan(self.aligner.sensors[0])
            self.rows.append((self.aligner.stamp, float(self.aligner.sensors[1])))

    def run(self, events: list[Event]) -> list[tuple[int, float]]:
        for event in events:
            self.take(*event)
        return self.rows


def regular(name: str, ks: range, every: int = 1, phase: int = 0) -> list[Event]:
    return [(START + k * every * STEP + phase, name, float(k)) for k in ks]


def merged(*streams: list[Event]) -> list[Event]:
    return sorted((event for stream in streams for event in stream), key=lambda e: e[0])


def offline(events: list[Event]) -> list[tuple[int, float]]:
    signals = {}
    for name in 'uys':
        mine = [(s, v) for s, n, v in events if n == name]
        signals[name] = Samples(np.array([s for s, _ in mine]), np.array([v for _, v in mine]),
                                True, 0)
    sensor = signals.pop('s')
    return [pair for series in to_grid(signals, ['u'], 0.002)
            for pair in zip(series.stamps.tolist(), beside(series, sensor).tolist(), strict=True)]


@st.composite
def recordings(draw: st.DrawFn) -> list[Event]:
    """Draw a sensor at a steady rate, with a phase and jitter, that may fail and come back."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    every = draw(st.sampled_from([0.25, 0.5, 1.0, 2.0, 5.0, 10.0]))
    phase = draw(st.sampled_from([0.0, 0.1, 0.3, 0.7, 0.9]))
    jitter = draw(st.sampled_from([0.0, 0.05]))
    stamps = START + np.rint(STEP * (
        every * np.arange(round(240 / every)) + phase
        + jitter * rng.uniform(-1.0, 1.0, round(240 / every)))).astype(np.int64)
    if draw(st.booleans()):
        stamps = stamps[(stamps < START + 100 * STEP) | (stamps > START + 150 * STEP)]
    sensor = [(int(stamp), 's', float(v)) for stamp, v in zip(
        stamps, rng.normal(size=len(stamps)), strict=True)]
    return merged(regular('u', range(240)), regular('y', range(240)), sensor)


@given(recordings())
@settings(max_examples=150, deadline=None)
def test_live_a_sensor_is_read_as_on_the_offline_grid(events: list[Event]) -> None:
    live, known = dict(Rig().run(events)), dict(offline(events))
    # Live, the last samples may still be waiting.
    stamps = list(known)[:225]
    assert np.array_equal([live[stamp] for stamp in stamps], [known[stamp] for stamp in stamps],
                          equal_nan=True)


@given(recordings(), st.integers(-8, 8))
@settings(max_examples=60, deadline=None)
def test_a_sensor_may_lag_or_lead_by_less_than_the_wait(events: list[Event], lag: int) -> None:
    arrived = sorted(events, key=lambda e: (e[0] + (e[1] == 's') * lag * STEP, e[0]))
    shorter, longer = sorted((Rig().run(events), Rig().run(arrived)), key=len)
    for one, other in zip(shorter, longer, strict=False):
        assert np.array_equal(one, other, equal_nan=True)


def test_a_sensor_that_never_comes_delays_the_start_once() -> None:
    rig = Rig(wait=0.02)
    made = []
    for event in merged(regular('u', range(300)), regular('y', range(300))):
        rig.take(*event)
        made.append(len(rig.rows))
    assert made[2 * 9] == 0
    assert made[2 * 12:] == [(k + 1) // 2 for k in range(2 * 12, 600)]
    assert all(math.isnan(value) for _, value in rig.rows)
    assert (rig.aligner.series, rig.sensor.filled) == (1, 1)


def test_a_sensor_that_is_given_up_stays_so_over_a_restart_until_it_comes() -> None:
    rig = Rig(wait=0.02)
    rig.sensor.awaited = False
    rig.run(merged(regular('u', range(50)), regular('y', range(50))))
    rig.aligner.restart()
    rig.run(merged(regular('u', range(50, 80)), regular('y', range(50, 80))))
    assert len(rig.rows) == 80
    rig.run(merged(*(regular(name, range(80, 200)) for name in 'uys')))
    assert [value for _, value in rig.rows[82:]] == [float(k) for k in range(82, 200)]
    assert rig.sensor.filled == 0


def test_a_sensor_that_fails_delays_once_and_is_used_again_when_it_comes_back() -> None:
    rig = Rig(wait=0.02)
    events = merged(regular('u', range(600)), regular('y', range(600)),
                    regular('s', range(100)), regular('s', range(300, 600)))
    behind = []
    for stamp, name, value in events:
        rig.take(stamp, name, value)
        behind.append(((stamp - START) // STEP, (stamp - START) // STEP + 1 - len(rig.rows)))
    assert max(late for _, late in behind) == 11                # the wait and a sample
    assert {late for k, late in behind if 115 < k < 299} == {0, 1}
    assert [value for _, value in rig.rows[:100]] == [float(k) for k in range(100)]
    assert all(math.isnan(value) for _, value in rig.rows[100:300])
    assert [value for _, value in rig.rows[302:]] == [float(k) for k in range(302, 600)]
    assert (rig.aligner.series, rig.sensor.filled) == (1, 1)


def test_a_slow_sensor_delays_no_sample_between_its_own() -> None:
    """On the grid it comes with the others; off it, its own sample waits for less than half."""
    for phase, most in ((0, 0), (STEP // 4, 1)):
        rig = Rig(wait=0.1)
        sensor = regular('s', range(60), 10, phase)
        for stamp, name, value in merged(sensor, regular('u', range(600)),
                                         regular('y', range(600))):
            rig.take(stamp, name, value)
            if name == 'y' and stamp > START + 100 * STEP:
                assert (stamp - START) // STEP + 1 - len(rig.rows) <= most
        there = [k for k, (_, value) in enumerate(rig.rows) if not math.isnan(value)]
        assert there[-50:] == [10 * k for k in range(60)][-50:]
        assert rig.sensor.late == 0


def test_a_sample_after_its_grid_time_was_made_is_counted() -> None:
    rig = Rig(wait=0.02)
    rig.run(merged(regular('u', range(100)), regular('y', range(100)), regular('s', range(50))))
    assert rig.sensor.late == 0
    rig.run(regular('s', range(50, 60)))
    assert rig.sensor.late == 10
    assert len(rig.rows) == 100


def test_what_is_wrong_with_a_sensor_leaves_the_others_as_they_are() -> None:
    """Stamps far ahead or back, twice the same, not a number."""
    rig = Rig(wait=0.02)
    rig.run(merged(regular('u', range(200)), regular('y', range(200)), regular('s', range(100)),
                   [(START + 100 * STEP + 1, 's', math.nan), (START + 100 * STEP + 2, 's', 1.0),
                    (START + 100 * STEP + 2, 's', 1.0)]))
    rig.take(START + 10**15, 's', 1.0)
    rig.take(START, 's', 1.0)
    rig.run(merged(*(regular(name, range(200, 300)) for name in 'uys')))
    assert [stamp for stamp, _ in rig.rows] == [START + k * STEP for k in range(300)]
    assert (rig.aligner.series, rig.aligner.jumps) == (1, 0)
    assert (rig.sensor.not_finite, rig.sensor.duplicates) == (1, 1)
    assert [value for _, value in rig.rows[-50:]] == [float(k) for k in range(250, 300)]


def test_where_time_jumps_back_the_sensor_begins_anew_with_the_others() -> None:
    for order in ('uys', 'suy'):
        rig = Rig()
        rig.run(sorted(merged(*(regular(name, range(1000, 1100)) for name in 'uys')),
                       key=lambda e: (e[0], order.index(e[1]))))
        rig.run(sorted(merged(*(regular(name, range(100)) for name in 'uys')),
                       key=lambda e: (e[0], order.index(e[1]))))
        assert rig.aligner.series == 2
        assert [value for _, value in rig.rows] == [
            float(k) for k in (*range(1000, 1100), *range(100))]
