"""Signals out of a rosbag2 bag, as recorded: their samples with their stamps."""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass, field
import errno
from itertools import batched
import logging
from pathlib import Path
import sqlite3
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.errors import BagError, UserError
from hydro_twin.recording import mcap
from hydro_twin.recording.cdr import Batch, CdrError, Extractor
from hydro_twin.recording.signals import SignalMap

log = logging.getLogger(__name__)

STORAGES = ('.mcap', '.db3')
STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
LOT = 16384   # messages in a batch


@dataclass(frozen=True)
class Samples:
    """One signal as recorded, in the unit of the plant.

    Attributes:
        stamps: strictly increasing [ns].
        stamped: whether they come from the messages' headers, else they are receive times.
        delay: median time from stamp to reception [ns].
    """

    stamps: IntArray
    values: FloatArray
    stamped: bool
    delay: int = 0


@dataclass
class _Topic:
    """What was read of one topic so far."""

    extractor: Extractor
    stamped: bool
    fields: Collection[str]
    expected: int
    received: list[IntArray] = field(default_factory=list)
    headers: list[IntArray] = field(default_factory=list)
    values: dict[str, list[FloatArray]] = field(default_factory=lambda: defaultdict(list))
    present: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))


def read_signals(path: Path, signals: Mapping[str, SignalMap], optional: Collection[str] = (),
                 ) -> dict[str, Samples]:
    """Read signals from one bag: a folder, or a single .mcap or .db3 file.

    Args:
        path: the bag.
        signals: where each signal is found.
        optional: signals that may be absent; they are then left out of the result. Values of
            these that are not finite are left out, too: so a sensor may say that it has failed.

    Raises:
        BagError: there is no such bag, it is damaged, or it does not hold the signals.
    """
    with opened(path) as reader:
        connections = _find_topics(path, reader, signals, optional)
        signals = {name: signal for name, signal in signals.items() if signal.topic in connections}
        topics: dict[str, _Topic] = {}
        for name, members in connections.items():
            msgtype = members[0].msgtype
            store = _typestore(reader, msgtype)
            stamped = dict(store.fielddefs[msgtype][1]).get('header', (0, ''))[1] == \
                'std_msgs/msg/Header'
            paths = {signal.field for signal in signals.values() if signal.topic == name}
            needed = {signal.field for key, signal in signals.items()
                      if signal.topic == name and key not in optional}
            taken = dict.fromkeys((*STAMP, *paths) if stamped else paths)
            topics[name] = _Topic(Extractor(msgtype, store, [*taken], paths - needed), stamped,
                                  paths, sum(connection.msgcount for connection in members))
        for name, batch in _from_bag(path, _batches(reader, connections)):
            _take(path, name, topics[name], batch)
    for name, topic in topics.items():
        count = sum(map(len, topic.received))
        if count != topic.expected:
            raise BagError(f'{path}: the bag promises {topic.expected} messages on {name}, '
                           f"but holds {count}: is it damaged? 'ros2 bag reindex' counts anew")
    found = {name: _samples(path, name, signal, topics[signal.topic], name in optional)
             for name, signal in signals.items()}
    return {name: samples for name, samples in found.items() if samples is not None}


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a bag for reading.

    What opening it raises, and going through its `messages()`, is turned into one line; what is
    raised by the one who reads it is not.

    Raises:
        BagError: there is no such bag, or it is damaged.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import get_typestore, Stores

    _check_path(path)
    with ExitStack() as stack:
        with _damage_named(path):
            reader: Any = stack.enter_context(
                AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)))
            for summary in ('topics', 'duration', 'message_count'):
                getattr(reader, summary)    # worked out when it is asked for
        messages: Callable[..., Iterator[Any]] = reader.messages
        reader.messages = lambda *args, **more: _from_bag(path, messages(*args, **more))
        yield reader


def _from_bag[T](path: Path, items: Iterable[T]) -> Iterator[T]:
    """Yield what is read from a bag; what reading it raises is turned into one line."""
    with _damage_named(path):
        yield from items


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """Turn all that a damaged bag may raise into one line."""
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        # A damaged byte makes rosbags raise anything, from AssertionError to ZstdError; what the
        # operating system says (no permission, no space) is another matter.
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            raise
        raise BagError(_damage(path, error)) from error


def _check_path(path: Path) -> None:
    """Refuse what cannot be a bag."""
    if not path.exists():
        raise BagError(f'{path}: no such bag')
    if path.is_file() and path.suffix not in STORAGES:
        raise BagError(f'{path} is not a rosbag2 bag: that is a folder with metadata.yaml, or a '
                       '.mcap or .db3 file')
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        files = sorted(str(file) for file in path.iterdir() if file.suffix in STORAGES)
        remedy = f"'ros2 bag reindex {path}' mends it, or name {files[0]}" if files else \
            'name the folder that holds it'
        raise BagError(f'{path} is not a whole rosbag2 bag: it has no metadata.yaml; {remedy}')


def _damage(path: Path, error: Exception) -> str:
    """Say how a bag is broken, and how much of it could be read."""
    files = [path] if path.is_file() else sorted(path.glob('*.mcap'))
    for file in files:
        if file.suffix != '.mcap' or file.stat().st_size < 2 * mcap.MAGIC:
            continue
        if mcap.is_mcap(file) and not mcap.is_whole(file):
            count, seconds = mcap.readable(file)
            return (f'{file} is cut short (was its recorder killed?): {count} messages over '
                    f"{seconds:.1f} s can still be read; 'mcap recover {file}' saves them")
    said = ' '.join(str(error).split())[:200] or type(error).__name__
    return f'{path} is damaged or not a rosbag2 bag: {said}'


def _find_topics(path: Path, reader: Any, signals: Mapping[str, SignalMap],
                 optional: Collection[str]) -> dict[str, list[Any]]:
    """Find the topics of the signals in the bag."""
    connections: dict[str, list[Any]] = defaultdict(list)
    for connection in reader.connections:
        connections[connection.topic].append(connection)
    if not any(connection.msgcount for connection in reader.connections):
        raise BagError(f'{path} holds no messages')
    wanted: dict[str, list[Any]] = {}
    for name, signal in signals.items():
        types = {connection.msgtype for connection in connections.get(signal.topic, ())}
        if not types:
            if name in optional:
                continue
            raise BagError(f'{path} has no topic {signal.topic} for signal {name}; it holds '
                           f'{_contents(reader)}')
        if types != {signal.type}:
            says = (f'{path}: {signal.topic} carries {" and ".join(sorted(types))}, but signal '
                    f'{name} expects {signal.type}: give its type and field in --config')
            if name in optional:
                log.warning('%s, or it is left out', says)
                continue
            raise BagError(says)
        if not sum(connection.msgcount for connection in connections[signal.topic]):
            if name in optional:
                continue
            raise BagError(f'{path} holds no messages on {signal.topic} for signal {name}')
        wanted[signal.topic] = connections[signal.topic]
    return wanted


def _contents(reader: Any) -> str:
    """List what a bag holds, with types and rates."""
    seconds = max(reader.duration * 1e-9, 1e-9)
    return ', '.join(
        f'{topic} ({info.msgtype or "of several types"}, {info.msgcount / seconds:.4g} Hz)'
        for topic, info in reader.topics.items())


def _typestore(reader: Any, msgtype: str) -> Any:
    """Return the type definitions of the bag, or ROS's own where the bag brings none."""
    from rosbags.typesys import get_typestore, Stores

    store = reader.typestore
    if msgtype not in store.fielddefs:
        store = get_typestore(Stores.ROS2_JAZZY)
    if msgtype not in store.fielddefs:
        raise BagError(f'the bag does not define {msgtype}, nor does ROS 2 Jazzy')
    return store


def _batches(reader: Any, connections: Mapping[str, Any]) -> Iterator[tuple[str, Batch]]:
    """Yield the messages of the topics, file after file, in the order in which they were written.

    rosbags opens the bag and knows its files; it sorts messages by receive time, which would hide
    a clock that jumped, and it makes an object of each, so the files are read here. It does not
    offer its files to others (`readers[0].storage`): hence the bound on its version in setup.py.
    """
    storage = reader.readers[0].storage
    if reader.readers[0].compression_mode == 'message':
        wanted = [connection for members in connections.values() for connection in members]
        for lot in batched(reader.messages(wanted), LOT):
            for topic in connections:
                yield from _joined(topic, [(t, raw) for c, t, raw in lot if c.topic == topic])
        return
    for file in getattr(storage, 'storages', [storage]):
        ids = {c.id: c.topic for c in file.connections if c.topic in connections}
        path = Path(str(file.path))
        yield from (mcap.batches if mcap.is_mcap(path) else _sqlite_batches)(path, ids)


def _sqlite_batches(path: Path, topics: Mapping[int, str]) -> Iterator[tuple[str, Batch]]:
    """Yield the messages of some topics of a sqlite3 file."""
    connection = sqlite3.connect(f'{path.resolve().as_uri()}?immutable=1', uri=True)
    try:
        for topic in set(topics.values()):
            ids = [key for key, name in topics.items() if name == topic]
            cursor = connection.execute(
                'SELECT timestamp, data FROM messages WHERE topic_id IN '
                f'({",".join("?" * len(ids))}) ORDER BY id', ids)
            while rows := cursor.fetchmany(LOT):
                yield from _joined(topic, rows)
    finally:
        connection.close()


def _joined(topic: str, rows: list[tuple[int, bytes]]) -> Iterator[tuple[str, Batch]]:
    """Join single messages to a batch."""
    if rows:
        received, payloads = zip(*rows, strict=True)
        length = np.fromiter(map(len, payloads), np.int64, len(payloads))
        yield topic, Batch(np.array(received, np.int64),
                           np.frombuffer(b''.join(payloads), np.uint8),
                           np.cumsum(length) - length, length)


def _take(path: Path, name: str, topic: _Topic, batch: Batch) -> None:
    """Add a batch to what was read of a topic."""
    try:
        columns = topic.extractor.take(batch)
    except CdrError as error:
        index = sum(map(len, topic.received)) + error.args[1]
        raise BagError(f'{path}: message {index} on {name} ({topic.extractor.msgtype}) '
                       f'{error.args[0]}') from None
    topic.received.append(batch.received)
    if topic.stamped:
        sec, nanosec = (columns.values[key].astype(np.int64) for key in STAMP)
        topic.headers.append(sec * 1_000_000_000 + nanosec)
    for key in topic.fields:
        topic.values[key].append(columns.values[key])
        topic.present[key].append(columns.present[key])


def _samples(path: Path, name: str, signal: SignalMap, topic: _Topic, optional: bool
             ) -> Samples | None:
    """Put the samples of one signal together, and check their clock and their values.

    Of an optional one only those with a value are taken; None if there are none.
    """
    stamped = topic.stamped
    received = stamps = np.concatenate(topic.received)
    if stamped:
        headers = np.concatenate(topic.headers)
        # A publisher that fills in no stamp leaves them all zero: then they say nothing.
        stamped = bool(headers.any())
        stamps = headers if stamped else stamps
    present = np.concatenate(topic.present[signal.field])
    values = signal.of(np.concatenate(topic.values[signal.field]))
    if optional:
        present &= np.isfinite(values)
        if not present.any():
            return None
    if not present.any():
        raise BagError(f'{path}: no message on {signal.topic} holds {signal.field} for signal '
                       f'{name}; the joints there are '
                       f'{topic.extractor.joints()}')
    values, stamps = values[present], stamps[present]
    steps = np.diff(stamps)
    if (steps < 0).any():
        k = int(np.argmax(steps < 0)) + 1
        clock = 'stamps' if stamped else 'receive times'
        raise BagError(f'{path}: the {clock} on {signal.topic} jump back by '
                       f'{-steps[k - 1] * 1e-9:.6g} s at message {k}, '
                       f'{(stamps[k - 1] - stamps[0]) * 1e-9:.6g} s after the first: cut the bag '
                       'there')
    if not np.isfinite(values).all():
        bad = np.flatnonzero(~np.isfinite(values))
        raise BagError(f'{path}: {len(bad)} of {len(values)} values of signal {name} on '
                       f'{signal.topic} are not finite, the first in message {bad[0]}')
    first = np.concatenate([[True], steps > 0])   # of messages with one stamp the first counts
    delay = int(np.median(received[present] - stamps))
    return Samples(stamps[first], values[first], stamped, delay)
