"""Writes recordings as rosbag2 bags, atomically."""
from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import heapq
from itertools import pairwise
from pathlib import Path
import tempfile
from typing import Any, TYPE_CHECKING

import numpy as np

from hydro_twin.arrays import IntArray
from hydro_twin.errors import BagError, DataError
from hydro_twin.files import named_in_errors
from hydro_twin.recording.bag import opened, read_signals, STAMP, STORAGES
from hydro_twin.recording.cdr import lay_out, Layout
from hydro_twin.recording.series import Series, StampedSeries
from hydro_twin.recording.signals import NAME_FIELDS, SignalMap, split_index

if TYPE_CHECKING:
    from rosbags.rosbag2 import Writer
    from rosbags.typesys.store import Typestore

Message = tuple[int, Any, bytes]   # receive time [ns], connection, content
LOT = 4096   # messages made at once


def write_recording(path: Path, series: Sequence[Series | StampedSeries],
                    signals: Mapping[str, SignalMap],
                    about: Mapping[str, str] | None = None) -> None:
    """Write series as a bag; signals on one topic travel in one message a sample.

    A sample at which all of them are nan, as of a sensor that has failed, is not written.

    Args:
        path: of the bag, a folder (mcap inside), or a single file if it ends in .mcap or .db3.
        series: in the order of time.
        signals: where each column of the series goes.
        about: what the bag's metadata shall say of its origin.

    Raises:
        BagError: the path exists already, or a field of the signal map is not in its type.
        DataError: a series does not begin after the end of the one before.
    """
    for before, after in pairwise(series):
        if after.stamps[0] <= before.stamps[-1]:
            raise DataError(f'series do not follow each other in time: one begins at '
                            f'{after.stamps[0]} ns, where the one before is still running')
    with _new_bag(path) as writer:
        for key, text in (about or {}).items():
            writer.set_custom_data(key, text)
        for received, connection, content in _messages(writer, series, signals, 0):
            writer.write(connection, received, content)


def write_messages(path: Path, topics: Mapping[str, tuple[str, bool]],
                   messages: Iterable[tuple[int, str, bytes]], store: Typestore,
                   about: Mapping[str, str] | None = None) -> int:
    """Write serialised messages as they came, as a bag.

    Args:
        path: of the bag, as for `write_recording`.
        topics: name -> type, and whether it is latched (transient local).
        messages: receive time [ns], topic and CDR, in the order of time.
        store: knows the types.
        about: what the bag's metadata shall say of its origin.

    Returns:
        How many were written.

    Raises:
        BagError: the path exists already.
    """
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    never = QosTime(9223372036, 854775807)
    latched = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
                  never, never, QosLiveliness.AUTOMATIC, never, False)
    count = 0
    with _new_bag(path) as writer:
        for key, text in (about or {}).items():
            writer.set_custom_data(key, text)
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=store,
                                         offered_qos_profiles=[latched] if stays else [])
            for topic, (msgtype, stays) in topics.items()}
        for received, topic, content in messages:
            writer.write(connections[topic], received, content)
            count += 1
    return count


def add_to_copy(source: Path, path: Path, series: Sequence[Series],
                signals: Mapping[str, SignalMap], beside: SignalMap) -> None:
    """Copy a bag, message for message, and add series on topics of their own.

    Args:
        source: the bag to copy.
        path: of the copy, as for `write_recording`.
        series: what to add, stamped in the clock of the source.
        signals: where each column of the series goes.
        beside: a signal of the source; what is added is received as late after its stamp as this.

    Raises:
        BagError: the source cannot be read or already has such a topic, or the path exists.
    """
    delay = read_signals(source, {'signal': beside})['signal'].delay
    with opened(source) as reader, _new_bag(path) as writer:
        if taken := {s.topic for s in signals.values()} & {c.topic for c in reader.connections}:
            raise BagError(f'{source} already has {", ".join(sorted(taken))}')
        connections = {}
        for topic, msgtype in dict.fromkeys((c.topic, c.msgtype) for c in reader.connections):
            qos = next(c.ext.offered_qos_profiles for c in reader.connections if c.topic == topic)
            connections[topic, msgtype] = writer.add_connection(
                topic, msgtype, typestore=reader.typestore, offered_qos_profiles=qos)
        copied = ((received, connections[c.topic, c.msgtype], raw)
                  for c, received, raw in reader.messages())
        added = _messages(writer, series, signals, delay)
        for received, connection, content in heapq.merge(copied, added, key=lambda m: m[0]):
            writer.write(connection, received, content)


@contextmanager
def _new_bag(path: Path) -> Iterator[Writer]:
    """Open a bag for writing in a hidden folder beside its place, and move it there when whole."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    if path.exists():
        raise BagError(f'{path} exists already: it is not overwritten')
    if not path.parent.is_dir():
        raise BagError(f'{path}: there is no folder {path.parent}')
    single = path.suffix in STORAGES
    plugin = StoragePlugin.SQLITE3 if path.suffix == '.db3' else StoragePlugin.MCAP
    with (named_in_errors(path),
          tempfile.TemporaryDirectory(prefix=f'.{path.name}.', dir=path.parent) as folder):
        bag = Path(folder) / (path.stem if single else path.name)
        with Writer(bag, version=9, storage_plugin=plugin) as writer:
            yield writer
        (bag / f'{bag.name}{path.suffix}' if single else bag).rename(path)


def _messages(writer: Writer, series: Iterable[Series | StampedSeries],
              signals: Mapping[str, SignalMap], delay: int) -> Iterator[Message]:
    """Yield the messages of series, topic beside topic, sample after sample."""
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    topics: dict[str, dict[str, SignalMap]] = {}
    for name, signal in signals.items():
        topics.setdefault(signal.topic, {})[name] = signal
    makers = []
    for topic, members in topics.items():
        msgtypes = {signal.type for signal in members.values()}
        if len(msgtypes) > 1:
            raise BagError(f'{topic} cannot carry {" and ".join(sorted(msgtypes))} at once')
        msgtype = msgtypes.pop()
        if msgtype not in store.fielddefs:
            raise BagError(f'{topic}: ROS 2 Jazzy has no standard message {msgtype}')
        connection = writer.add_connection(topic, msgtype, typestore=store)
        makers.append((connection, _template(msgtype, members, store), members))
    for one in series:
        stamps = one.stamps
        for begin in range(0, len(stamps), LOT):
            lot = stamps[begin:begin + LOT]
            rows = [_filled(layout, lot, {signal.field: signal.raw(one[name][begin:begin + LOT])
                                          for name, signal in members.items()})
                    for _, layout, members in makers]
            silent = [np.all([np.isnan(one[name][begin:begin + LOT]) for name in members], axis=0)
                      for _, _, members in makers]
            for k, stamp in enumerate(lot.tolist()):
                for (connection, _, _), contents, skipped in zip(makers, rows, silent,
                                                                 strict=True):
                    if not skipped[k]:
                        yield stamp + delay, connection, contents[k]


def _filled(layout: Layout, stamps: IntArray, columns: Mapping[str, Any]) -> list[bytes]:
    """Write stamps and columns into copies of a template message."""
    rows = np.tile(np.frombuffer(layout.payload, np.uint8), (len(stamps), 1))
    if STAMP[0] in layout.leaves:
        columns = dict(zip(STAMP, np.divmod(stamps, 1_000_000_000), strict=True)) | dict(columns)
    for path, column in columns.items():
        leaf = layout.leaf(path)
        assert leaf is not None   # the template was made with this very joint
        numbers = np.rint(column) if leaf.dtype[1] in 'iu' else column
        content = numbers.astype(leaf.dtype)[:, None].view(np.uint8)
        rows[:, leaf.offset:leaf.offset + content.shape[1]] = content
    return [row.tobytes() for row in rows]


def _template(msgtype: str, signals: Mapping[str, SignalMap], store: Typestore) -> Layout:
    """Make a message large enough for the fields of some signals, and lay it out."""
    joints: dict[str, list[str]] = {}   # prefix of a group of arrays -> its joints
    lengths: dict[str, int] = {}
    for name, signal in signals.items():
        path, index = split_index(signal.field)
        if index is not None:
            group = joints.setdefault(path[:path.rfind('.') + 1], [])
            while index.isdecimal() and len(group) <= int(index):
                group.append(name if len(group) == int(index) else f'joint_{len(group)}')
            if not index.isdecimal() and index not in group:
                group.append(index)
        for end in [k for k, letter in enumerate(path) if letter == ']']:
            owner, element = split_index(path[:end + 1])
            lengths[owner] = max(lengths.get(owner, 0), int(element or 0) + 1)
    for signal in signals.values():
        path, index = split_index(signal.field)
        if index is not None:
            lengths[path] = len(joints[path[:path.rfind('.') + 1]])
    message = _blank(msgtype, '', store, lengths, joints)
    content = bytes(store.serialize_cdr(message, msgtype))
    layout = lay_out(content, msgtype, store)
    for signal in signals.values():
        layout.leaf(signal.field)
    return layout


def _blank(msgtype: str, prefix: str, store: Typestore, lengths: Mapping[str, int],
           joints: Mapping[str, list[str]]) -> Any:
    """Make a message of zeros; arrays of numbers that need not be there are empty."""
    def value(kind: int, about: Any, path: str) -> Any:
        if kind == 2:   # the kinds are those of rosbags.interfaces.Nodetype
            return _blank(about, f'{path}.', store, lengths, joints)
        if kind == 1:
            return '' if about[0] == 'string' else False if about[0] == 'bool' else 0
        (item_kind, item), size = about
        count = size if kind == 3 else lengths.get(path, 0)
        if item_kind == 1 and item[0] != 'string':
            return np.zeros(count, 'u1' if item[0] in ('byte', 'char', 'octet') else item[0])
        if item_kind == 1 and kind == 4 and path.removeprefix(prefix) in NAME_FIELDS:
            return joints.get(prefix, [])
        return [value(int(item_kind), item, f'{path}[{k}]') for k in range(count)]

    return store.types[msgtype](*(value(int(kind), about, f'{prefix}{name}')
                                  for name, (kind, about) in store.fielddefs[msgtype][1]))
