"""The live aligner against the offline grid, and what a rig does to it."""
from __future__ import annotations

import math
from random import Random

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from hydro_twin.live.aligner import Aligner
from hydro_twin.live.track import BACKLOG, OUTPUT, Track
from hydro_twin.recording.bag import Samples
from hydro_twin.recording.grid import to_grid

STEP = 2_000_000


def tracks() -> dict[str, Track]:
    return {'u': Track('u', 0, True, STEP), 'd': Track('d', 1, False, STEP),
            'y': Track('y', OUTPUT, False, STEP)}


def run(events: list[tuple[int, str, float]], wait: float = 10.0) -> list[tuple[object, ...]]:
    """Push samples in the order given."""
    signals = tracks()
    aligner = Aligner(tuple(signals.values()), 0.002, wait)
    out = []
    for stamp, name, value in events:
        aligner.push(signals[name], stamp, value)
        while aligner.advance():
            out.append((aligner.stamp, *aligner.inputs.tolist(), aligner.measured, aligner.first))
    return out


def offline(events: list[tuple[int, str, float]]) -> list[tuple[object, ...]]:
    """Do the same by the rule for whole bags, of the stretches long enough to be kept there."""
    signals = {}
    for name in 'udy':
        mine = sorted((s, v) for s, n, v in events if n == name)
        signals[name] = Samples(np.array([s for s, _ in mine]),
                                np.array([v for _, v in mine]), True, 0)
    rows = []
    for series in to_grid(signals, ['u'], 0.002):
        for k in range(len(series)):
            rows.append((series.start + k * STEP, *(float(series[n][k]) for n in 'udy'), k == 0))
    return rows


def test_commands_a_rounding_error_after_the_grid_are_on_it() -> None:
    events = [(10**18 + k * STEP + (name == 'u' and k % 3), name, float(k))
              for k in range(30) for name in 'dyu']
    assert [row[1] for row in run(events)] == list(range(30))
    assert run(events) == offline(events)


@st.composite
def recordings(draw: st.DrawFn) -> list[tuple[int, str, float]]:
    """Three signals at steady rates with jitter and phases of their own, and shared pauses."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    start = draw(st.sampled_from([0, 1_700_000_000_000_000_123]))
    pause_after = draw(st.integers(40, 60))
    pause = draw(st.sampled_from([0, 30 * STEP, 200 * STEP]))
    events = []
    for name in 'udy':
        ratio = draw(st.sampled_from([1, 1, 2]))
        jitter = draw(st.sampled_from([0, STEP // 8]))
        phase = draw(st.integers(0, STEP - 1)) if draw(st.booleans()) else 0
        count = 120 // ratio
        stamps = start + phase + np.arange(count) * STEP * ratio
        stamps[np.arange(count) * ratio >= pause_after] += pause
        stamps += rng.integers(0, jitter + 1, count)
        events += [(int(s), name, float(v)) for s, v in zip(stamps, rng.normal(size=count),
                                                            strict=True)]
    return sorted(events)


@given(recordings())
@settings(max_examples=150, deadline=None)
def test_live_makes_the_samples_of_the_offline_grid(events: list[tuple[int, str, float]]) -> None:
    expected = offline(events)
    live = run(events)
    # Live, a sample waits for every signal, so the last few of a record may still be waiting.
    known = {row[0]: row for row in live}
    reach = min(max(s for s, n, _ in events if n == name) for name in 'udy')
    assert [known.get(row[0]) for row in expected if row[0] <= reach] == \
        [row for row in expected if row[0] <= reach]
    assert [row[0] for row in live] == sorted({row[0] for row in live})


@given(recordings(), st.randoms(use_true_random=False))
@settings(max_examples=60, deadline=None)
def test_the_order_of_topics_does_not_matter(events: list[tuple[int, str, float]], random: Random
                                             ) -> None:
    """Signals may overtake each other by less than the wait; each keeps its own order."""
    lag = {name: random.randrange(20) * STEP for name in 'udy'}
    arrived = sorted(events, key=lambda e: (e[0] + lag[e[1]], e[0]))
    shorter, longer = sorted((run(events), run(arrived)), key=len)
    assert longer[:len(shorter)] == shorter


def test_a_command_a_rounding_error_after_the_grid_delays_no_series() -> None:
    """After a pause the position comes last, when its gap is not known yet."""
    stamps = [k * STEP for k in (*range(41), *range(71, 120))]
    events = sorted([(s + 1, 'u', float(s)) for s in stamps] + [(s, 'd', 0.0) for s in stamps]
                    + [(s, 'y', 0.0) for s in stamps if s // STEP % 2 == 0])
    arrived = sorted(events, key=lambda e: e[0] + (e[1] == 'd') * 5 * STEP)
    assert run(arrived) == run(events) == offline(events)


def regular(name: str, ks: range, value: float = 1.0) -> list[tuple[int, str, float]]:
    return [(k * STEP, name, value) for k in ks]


def merged(*streams: list[tuple[int, str, float]]) -> list[tuple[int, str, float]]:
    return sorted((event for stream in streams for event in stream), key=lambda e: e[0])


def test_a_late_command_is_held_after_the_wait_and_no_longer_than_a_gap_may_last() -> None:
    rows = run(merged(regular('u', range(50)), regular('d', range(200)),
                      regular('y', range(200))), wait=0.02)
    assert [row[0] // STEP for row in rows] == list(range(55))   # five periods more


def test_a_command_sent_once_holds() -> None:
    rows = run(merged(regular('u', range(1), 7.0), regular('d', range(300)),
                      regular('y', range(300))), wait=0.02)
    assert len(rows) > 280
    assert {row[1] for row in rows} == {7.0}


def test_a_signal_that_lags_over_a_pause_still_brings_what_was_before_it() -> None:
    """Topics overtake each other; here the command is a whole pause ahead of the others."""
    stamps = [10**15 + k * STEP for k in (*range(60), *range(1060, 1120))]
    samples = {name: [(stamp, name, math.sin(stamp / 1e9)) for stamp in stamps] for name in 'udy'}
    whole = [sample for three in zip(*samples.values(), strict=True) for sample in three]
    ahead = 90   # samples, 30 of them on the other side of the pause
    events = samples['u'][:ahead]
    for k in range(120):
        events += [*samples['u'][ahead + k:ahead + k + 1], samples['d'][k], samples['y'][k]]
    assert run(events) == run(whole) == offline(whole)


def test_without_the_output_predictions_go_on() -> None:
    rows = run(merged(regular('u', range(300)), regular('d', range(300)),
                      regular('y', range(100))), wait=0.02)
    assert [row[0] // STEP for row in rows] == list(range(rows[-1][0] // STEP + 1))
    assert rows[-1][0] // STEP > 280
    assert all(math.isnan(row[3]) == (row[0] // STEP >= 100) for row in rows)
    assert [row[0] for row in rows if row[4]] == [0]


def test_the_output_that_comes_back_begins_a_series() -> None:
    rows = run(merged(regular('u', range(400)), regular('d', range(400)),
                      regular('y', range(100)), regular('y', range(200, 400))), wait=0.02)
    # Sample 200 was made without it, since nobody waits for what has been away.
    assert [row[0] // STEP for row in rows if row[4]][1:] == [201]


@pytest.mark.parametrize(('fault', 'counter'), [
    ((10 * STEP, 'd', 5.0), 'reordered'), ((99 * STEP, 'd', 5.0), 'duplicates'),
    ((100 * STEP, 'd', math.nan), 'not_finite'), ((100 * STEP, 'd', math.inf), 'not_finite'),
])
def test_a_bad_sample_is_counted_and_leaves_no_trace(fault: tuple[int, str, float],
                                                     counter: str) -> None:
    signals = tracks()
    aligner = Aligner(tuple(signals.values()), 0.002, 0.1)
    out = []
    good = merged(*(regular(name, range(100)) for name in 'udy'))
    after = merged(*(regular(name, range(100, 200)) for name in 'udy'))
    for stamp, name, value in [*good, fault, *after]:
        aligner.push(signals[name], stamp, value)
        while aligner.advance():
            out.append((aligner.stamp // STEP, *aligner.inputs))
    assert out == [(k, 1.0, 1.0) for k in range(200)]
    assert getattr(signals['d'], counter) == 1


def test_a_clock_that_jumps_back_starts_over() -> None:
    first = merged(*(regular(name, range(1000, 1100)) for name in 'udy'))
    again = merged(*(regular(name, range(100)) for name in 'udy'))
    rows = run(first + again)
    assert [row[0] // STEP for row in rows if row[4]] == [1000, 0]
    assert len(rows) == 200


def test_a_stamp_from_far_ahead_fills_nothing_in() -> None:
    rows = run(merged(*(regular(name, range(100)) for name in 'udy'),
                      [(10**15, 'u', 1.0)]))
    assert len(rows) == 100


def test_nothing_grows_without_bound_while_an_input_is_missing() -> None:
    signals = tracks()
    aligner = Aligner(tuple(signals.values()), 0.002, 0.1)
    for k in range(3 * BACKLOG):
        aligner.push(signals['d'], k * STEP, 1.0)
        assert not aligner.advance()
    assert len(signals['d'].after) <= BACKLOG


def test_silence_is_filled_in_for_commands_that_rest() -> None:
    """A plant with nothing but a resting command still runs with the clock."""
    command = Track('u', 0, True, STEP)
    output = Track('y', OUTPUT, False, STEP)
    aligner = Aligner((command, output), 0.002, 0.02)
    aligner.push(command, 0, 1.0)
    made = 0
    for silence in range(0, 400_000_000, 20_000_000):
        aligner.note_silence(silence)
        while aligner.advance():
            made += 1
    assert made == (380_000_000 - 20_000_000) // STEP + 1
