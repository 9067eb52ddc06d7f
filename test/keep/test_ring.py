"""The ring of messages and what is captured of it."""
from __future__ import annotations

import json
from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from hydro_twin.errors import BagError
from hydro_twin.keep.capture import BAG, Capture, close, LONGEST, prune, untraced, Wanted, write
from hydro_twin.keep.ring import OVERHEAD, Ring, SECOND
from hydro_twin.recording.digest import source_of

STORE = get_typestore(Stores.ROS2_JAZZY)
STRING = 'std_msgs/msg/String'
TOPICS = {'/a': (STRING, False), '/map': (STRING, True)}


def text(said):
    return bytes(STORE.serialize_cdr(STORE.types[STRING](said), STRING))


def filled(seconds, count, most=1 << 20):
    """Fill a ring with a message a second, and a latched one at the begin."""
    ring = Ring(seconds, most)
    ring.latch('/map')
    ring.add('/map', 0, 1000, text('the map'))
    for k in range(count):
        ring.add('/a', k * SECOND, 1000 + k, text(f'{k}'))
    return ring


def said(messages):
    messages_: list[Any] = [STORE.deserialize_cdr(content, STRING) for *_, content in messages]
    return [message.data for message in messages_]


def test_old_messages_go_but_the_last_before_the_window_and_latched_ones_stay():
    ring = filled(10, 100)
    assert said(ring.stretch(0)) == ['the map', *(f'{k}' for k in range(89, 100))]
    # What held at the begin of a stretch is in it.
    ring.add('/a', 99 * SECOND + SECOND // 2, 1200, text('half'))
    assert said(ring.stretch(95 * SECOND + 1)) == ['the map', '95', '96', '97', '98', '99', 'half']
    assert ring.span() == pytest.approx(10.5)
    ring.clear()
    assert said(ring.stretch(0)) == ['the map']


@given(st.lists(st.tuples(st.sampled_from('abc'), st.integers(0, 2 * SECOND),
                          st.integers(0, 3000)), max_size=80), st.integers(1, 20_000))
@example([('a', 0, 0), ('a', 0, 0)], 400)       # at one time, and that is where the stretch begins
def test_the_bound_in_bytes_holds_whatever_comes(arrivals, most):
    ring = Ring(20.0, most)
    ring.latch('c')
    now, kept = 0, []
    for topic, pause, size in arrivals:
        now += pause
        ring.add(topic, now, now, bytes(size))
        kept = ring.stretch(0)
        held = sum(len(content) + OVERHEAD for _, _, content in kept)
        assert ring.size == held
        assert held <= most or len(kept) == 1
    assert [message[0] for message in kept] == sorted(message[0] for message in kept)
    latched = sum(topic == 'c' for topic, _, _ in arrivals)
    assert sum(topic == 'c' for _, topic, _ in kept) >= latched - ring.dropped


def test_latched_messages_are_the_last_to_go():
    ring = filled(1000, 3, 4 * (OVERHEAD + 30))
    for k in range(10):
        ring.add('/a', (3 + k) * SECOND, 2000 + k, text('x' * 10))
    assert said(ring.stretch(0))[0] == 'the map'
    assert ring.dropped > 5


def test_a_second_event_extends_a_capture_but_not_for_ever():
    ring = filled(10, 50)
    capture = Capture(ring)
    capture.ask(50 * SECOND, 20.0, 'one')
    for k in range(50, 65):
        ring.add('/a', k * SECOND, 1000 + k, text(f'{k}'))
    capture.ask(65 * SECOND, 20.0, 'two', since=60 * SECOND)
    assert capture.take(71 * SECOND) is None
    for k in range(65, 86):
        ring.add('/a', k * SECOND, 1000 + k, text(f'{k}'))
    wanted, messages = capture.take(85 * SECOND)
    assert wanted.why == ('one', 'two')
    # The whole of it, though the ring alone would hold ten seconds.
    assert said(messages) == ['the map', *(f'{k}' for k in range(40, 86))]
    assert capture.take(90 * SECOND) is None
    ring.add('/a', 86 * SECOND, 1086, text('86'))
    assert said(ring.stretch(0))[1] == '76'      # the window again
    for k in range(100, 1000, 10):
        capture.ask(k * SECOND, 20.0, 'again')
    assert capture.wanted.end == 100 * SECOND + round(LONGEST * 20 * SECOND)


def test_what_is_written_is_what_came(tmp_path):
    ring = filled(10, 30)
    wanted = Wanted(0, 1, 0, ('refit',))
    messages = ring.stretch(0)
    captured = write(tmp_path / 'captures', wanted, messages, TOPICS | {'/no': (STRING, False)},
                     STORE)
    assert captured.sha256 == source_of(captured.bag).sha256
    with AnyReader([captured.bag]) as reader:
        read = [(stamp, connection.topic, raw)
                for connection, stamp, raw in reader.messages()]
        assert read == messages
        latched = {c.topic: [q.durability.name for q in c.ext.offered_qos_profiles]
                   for c in reader.connections}
        assert latched == {'/a': [], '/map': ['TRANSIENT_LOCAL']}
    assert 'refit' in json.dumps((captured.bag / 'metadata.yaml').read_text())
    with pytest.raises(BagError, match='no message'):
        write(tmp_path / 'captures', wanted, [], TOPICS, STORE)
    assert [one.bag.name for one in untraced(tmp_path / 'captures')] == [BAG]


def test_captures_are_traced_once_and_the_oldest_go(tmp_path):
    folder = tmp_path / 'captures'
    made = [write(folder, Wanted(0, 1, 0, ()), filled(9, 3).stretch(0), TOPICS, STORE)
            for _ in range(4)]
    (folder / '.20260101T000000.0Z').mkdir()        # cut short by a kill
    assert untraced(folder) == made
    assert not list(folder.glob('.*'))
    for one in made[:2]:
        close(one, 'failed')
    assert untraced(folder) == made[2:]
    prune(folder, 1, {made[1].bag})
    assert untraced(folder) == made[2:]             # what waits is kept
    assert not made[0].folder.exists()
