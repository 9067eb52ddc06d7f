"""Messages of an mcap file in batches, by its message indexes; says how far a cut one can be read.

Format: https://mcap.dev/spec. A file is a row of records, each an opcode, a length and a content;
a chunk holds (compressed) message records, and index records behind it say where.
"""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
import struct

import numpy as np

from hydro_twin.arrays import IntArray
from hydro_twin.recording.cdr import Batch, ByteArray

MAGIC = 8
MESSAGE, CHUNK, MESSAGE_INDEX = 0x05, 0x06, 0x07
PREFIX = struct.Struct('<BQ')   # opcode, length
CHUNK_HEAD = struct.Struct('<QQQII')   # start, end, size once uncompressed, crc, length of a name
MESSAGE_HEAD = np.dtype([('opcode', 'u1'), ('size', '<u8'), ('channel', '<u2'),
                         ('sequence', '<u4'), ('log_time', '<u8'), ('publish_time', '<u8')])
INDEX_ENTRY = np.dtype([('log_time', '<u8'), ('offset', '<i8')])
LOT = 16384   # messages in a batch, where the file has no chunks


class CutError(Exception):
    """The file ends, or makes no sense, from some place on."""


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an mcap file does."""
    with path.open('rb') as file:
        return file.read(MAGIC)[1:5] == b'MCAP'


def is_whole(path: Path) -> bool:
    """Whether an mcap file ends with what it begins with, as its writer leaves it."""
    with path.open('rb') as file:
        head = file.read(MAGIC)
        file.seek(-MAGIC, 2)
        return file.read() == head


def batches(path: Path, topics: Mapping[int, str]) -> Iterator[tuple[str, Batch]]:
    """Yield the messages of some topics, batch by batch, in the order of the file.

    Args:
        path: the file.
        topics: id of a channel -> its topic.

    Raises:
        CutError: the file is damaged.
    """
    data = np.memmap(path, np.uint8, mode='r').view(np.ndarray)
    chunk: ByteArray | None = None
    index: dict[int, IntArray] = {}
    loose: list[int] = []
    for opcode, begin, end in _records(data, MAGIC):
        if opcode == MESSAGE_INDEX and chunk is not None:
            channel, _ = struct.unpack_from('<HI', data, begin)
            index[channel] = data[begin + 6:end].view(INDEX_ENTRY)['offset']
            continue
        if chunk is not None:
            yield from _chunk_batches(chunk, index, topics)
            chunk, index = None, {}
        if opcode == CHUNK:
            chunk = data[begin:end]
        elif opcode == MESSAGE:
            loose.append(begin - PREFIX.size)
        if len(loose) == LOT:
            yield from _split(data, np.array(loose), topics)
            loose.clear()
    if chunk is not None:
        yield from _chunk_batches(chunk, index, topics)
    if loose:
        yield from _split(data, np.array(loose), topics)


def readable(path: Path) -> tuple[int, float]:
    """Count what a file that was cut short still holds.

    Returns:
        The number of messages before the break, and the time that they span [s].
    """
    data = np.memmap(path, np.uint8, mode='r').view(np.ndarray)
    times: list[IntArray] = []
    loose: list[int] = []
    with suppress(Exception):   # whatever the break makes of the bytes: it ends there
        for opcode, begin, end in _records(data, MAGIC):
            if opcode == CHUNK:
                chunk = _uncompressed(data[begin:end])
                times.append(_heads(chunk, _messages(chunk))['log_time'])
            elif opcode == MESSAGE:
                loose.append(begin - PREFIX.size)
    with suppress(CutError):    # a record too short to be a message
        times.append(_heads(data, np.array(loose, np.int64))['log_time'])
    found = np.concatenate(times) if times else np.zeros(0, np.uint64)
    return len(found), float(np.ptp(found)) * 1e-9 if len(found) else 0.0


def _records(data: ByteArray, at: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of the content of every record."""
    while at < len(data) - MAGIC:
        opcode, size = PREFIX.unpack_from(data, at)
        begin, at = at + PREFIX.size, at + PREFIX.size + size
        if opcode == 0 or at > len(data):
            raise CutError(f'breaks at byte {begin - PREFIX.size}')
        yield opcode, begin, at


def _messages(chunk: ByteArray) -> IntArray:
    """Walk a chunk that has no index, return where its message records begin."""
    padded = np.concatenate([chunk, np.zeros(MAGIC, np.uint8)])   # stands for the closing magic
    return np.array([begin - PREFIX.size for opcode, begin, _ in _records(padded, 0)
                     if opcode == MESSAGE], np.int64)


def _uncompressed(chunk: ByteArray) -> ByteArray:
    """Return the records in a chunk."""
    from rosbags.rosbag2.storage_mcap import decompress

    if len(chunk) < CHUNK_HEAD.size + 8:
        raise CutError('has a chunk without content')
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(chunk)
    at = CHUNK_HEAD.size + name_length
    name = chunk[CHUNK_HEAD.size:at].tobytes().decode()
    content = chunk[at + 8:]
    if not name and not crc and size == len(content):
        return content
    raw = decompress(content.tobytes(), name, size, crc)
    return np.frombuffer(raw, np.uint8)


def _chunk_batches(chunk: ByteArray, index: Mapping[int, IntArray], topics: Mapping[int, str],
                   ) -> Iterator[tuple[str, Batch]]:
    """Yield what a chunk holds of the topics."""
    if index and not topics.keys() & index.keys():
        return
    records = _uncompressed(chunk)
    if not index:
        yield from _split(records, _messages(records), topics)
        return
    wanted = np.concatenate([index[channel] for channel in topics.keys() & index.keys()])
    yield from _split(records, np.sort(wanted), topics)


def _heads(data: ByteArray, offsets: IntArray) -> np.ndarray:
    """Read the heads of message records."""
    size = MESSAGE_HEAD.itemsize
    if len(offsets) == 0:
        return np.zeros(0, MESSAGE_HEAD)
    if offsets.min() < 0 or offsets.max() + size > len(data):
        raise CutError('has a damaged index')
    return np.lib.stride_tricks.sliding_window_view(data, size)[offsets].view(MESSAGE_HEAD)[:, 0]


def _split(data: ByteArray, offsets: IntArray, topics: Mapping[int, str],
           ) -> Iterator[tuple[str, Batch]]:
    """Sort message records by topic."""
    heads = _heads(data, offsets)
    begin = offsets + MESSAGE_HEAD.itemsize
    length = heads['size'].astype(np.int64) - (MESSAGE_HEAD.itemsize - PREFIX.size)
    if (heads['opcode'] != MESSAGE).any() or (length < 0).any() or (
            begin + length > len(data)).any():
        raise CutError('has a damaged message record')
    channels: dict[str, list[int]] = defaultdict(list)
    for channel, topic in topics.items():
        channels[topic].append(channel)
    for topic, ids in channels.items():
        mine = np.isin(heads['channel'], ids)
        if mine.any():
            yield topic, Batch(heads['log_time'][mine].astype(np.int64), data, begin[mine],
                               length[mine])
