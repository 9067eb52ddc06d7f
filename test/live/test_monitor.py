"""The watch on the residual: hours of noise, white and coloured, and rises to be found."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_twin.live.monitor import (
    BATCH,
    design,
    LEARN,
    Monitor,
    relative_long_run_variance,
    WhitenessCusum,
)

DT = 0.002
RATE = round(BATCH / DT)


def coloured(white: np.ndarray, memory: float) -> np.ndarray:
    """Make noise of RMS 1 that forgets within `memory` seconds of white noise of RMS 1."""
    a = np.exp(-DT / memory) if memory else 0.0
    return lfilter([1.0], [1.0, -a], white * np.sqrt(1.0 - a * a))


def noise(seconds: int, memory: float, rng: np.random.Generator) -> np.ndarray:
    """Draw normal noise of RMS 1 that forgets within `memory` seconds."""
    return coloured(rng.normal(size=round(seconds / DT)), memory)


def watch(residual: np.ndarray, reference_rms: float = 1.0) -> tuple[Monitor, list[float]]:
    """Feed a residual; whole batches at once, which `add` sums sample by sample."""
    monitor = Monitor(reference_rms, DT)
    for k, value in enumerate(residual[:LEARN].tolist()):
        monitor.add(round(k * DT * 1e9), value)
    begin = LEARN // RATE * RATE
    for k in range(begin, len(residual) - RATE, RATE):
        monitor._batches.append((round(k * DT * 1e9), round((k + RATE) * DT * 1e9),
                                 float(np.sum(residual[k:k + RATE]**2)), RATE))
        monitor.judge()
    return monitor, []


def test_white_noise_has_the_textbook_variance_of_squares() -> None:
    rng = np.random.default_rng(1)
    found = [relative_long_run_variance(rng.normal(size=LEARN)) for _ in range(100)]
    assert 2.0 <= np.mean(found) <= 2.0 * 2.0 * 1.1   # an upper limit of twice the estimate


@pytest.mark.parametrize('memory', [0.0, 0.01, 0.2])
def test_no_false_alarm_in_six_hours(memory: float) -> None:
    monitor, _ = watch(noise(6 * 3600, memory, np.random.default_rng(5)))
    assert monitor.rise is None
    assert monitor.rms == pytest.approx(1.0, rel=0.3)


@pytest.mark.slow
def test_at_most_one_false_alarm_a_day() -> None:
    """Of any colour; drawn once for all of them."""
    rng = np.random.default_rng(11)
    alarms = dict.fromkeys((0.0, 0.02, 0.1, 0.5), 0)
    for _ in range(9):
        white = rng.normal(size=round(8 * 3600 / DT))
        for memory in alarms:
            alarms[memory] += watch(coloured(white, memory))[0].rise is not None
    assert max(alarms.values()) <= 3, alarms   # in three days


@pytest.mark.parametrize('memory', [0.0, 0.05])
def test_a_rise_by_a_fifth_is_found_about_when_stated(memory: float) -> None:
    rng = np.random.default_rng(2)
    delays, stated = [], []
    for _ in range(20):
        residual = noise(900, memory, rng)
        onset = 300.0
        residual[round(onset / DT):] *= 1.2
        monitor, _ = watch(residual)
        assert monitor.rise is not None
        assert monitor.chart is not None
        assert monitor.rise.begin * 1e-9 > onset - 10 * monitor.chart.delay - 5
        delays.append(monitor.rise.end * 1e-9 - onset)
        stated.append(monitor.chart.delay)
    assert 0.0 < np.mean(delays) < 1.5 * np.mean(stated) + BATCH


def test_a_model_that_never_held_is_found_too() -> None:
    monitor, _ = watch(noise(120, 0.01, np.random.default_rng(3)), reference_rms=0.5)
    assert monitor.rise is not None
    assert monitor.rise.rms == pytest.approx(1.0, rel=0.3)


def test_a_residual_that_repeats_is_no_alarm() -> None:
    time = np.arange(0.0, 1800.0, DT)
    monitor, _ = watch(np.sqrt(2.0) * np.sin(2 * np.pi * 7.0 * time))
    assert monitor.rise is None


def test_colour_costs_delay() -> None:
    assert design(2.0, DT).delay < design(200.0, DT).delay < design(20000.0, DT).delay


def test_the_hot_path_only_sums() -> None:
    monitor = Monitor(1.0, DT)
    for k in range(5 * RATE):
        monitor.add(k, 2.0)
    assert [batch[2:] for batch in monitor._batches] == [(4.0 * RATE, RATE)] * 5
    assert monitor.judge() is None


def test_the_residual_of_a_plant_slower_than_a_batch_is_judged() -> None:
    rng = np.random.default_rng(4)
    monitor = Monitor(1.0, 5.0)
    for k, value in enumerate([*rng.normal(size=LEARN), *(3.0 * rng.normal(size=2000))]):
        monitor.add(k * 5_000_000_000, float(value))
    rise = monitor.judge()
    assert rise is not None
    assert rise.begin > 0.9 * LEARN * 5_000_000_000


def alarm_after(colour: WhitenessCusum, residual: np.ndarray, learned: int = 33) -> int | None:
    """Feed batches of a second; returns the first one with an alarm."""
    batches = residual[:len(residual) // RATE * RATE].reshape(-1, RATE)
    for k, batch in enumerate(batches):
        if colour.take(batch, k < learned):
            return k
    return None


def test_white_noise_is_no_colour_in_twelve_hours() -> None:
    white = np.random.default_rng(6).normal(size=12 * 3600 * RATE)
    assert alarm_after(WhitenessCusum(BATCH), white) is None


def test_the_colour_of_a_residual_is_found_within_seconds_at_the_same_level() -> None:
    """An AR(1) innovation of which the past predicts a tenth, after a minute of white noise."""
    rng = np.random.default_rng(7)
    delays = []
    for _ in range(20):
        white = rng.normal(size=60 * RATE)
        memory = DT / -np.log(np.sqrt(0.1))
        residual = np.r_[white, noise(60, memory, rng)]
        found = alarm_after(WhitenessCusum(BATCH), residual)
        assert found is not None
        delays.append(found - 60)
    assert 0 <= np.mean(delays) < 5


def test_a_residual_that_always_was_coloured_is_watched_for_more() -> None:
    rng = np.random.default_rng(8)
    assert alarm_after(WhitenessCusum(BATCH), noise(3600, 0.002, rng)) is None
    more = np.r_[noise(60, 0.002, rng), noise(120, 0.02, rng)]
    assert 60 <= (alarm_after(WhitenessCusum(BATCH), more) or 0) < 80


def test_the_monitor_of_an_observer_says_that_it_is_the_colour() -> None:
    rng = np.random.default_rng(9)
    residual = np.r_[rng.normal(size=60 * RATE), noise(30, 0.005, rng)]
    for white in (True, False):
        monitor = Monitor(1.0, DT, white)
        for k, value in enumerate(residual.tolist()):
            monitor.add(round(k * DT * 1e9), value)
        found = monitor.judge()
        assert (found is not None) == white
        if found is not None:
            assert found.sign == 'colour'
            assert 59.0 < found.begin * 1e-9 < found.end * 1e-9 < 75.0
