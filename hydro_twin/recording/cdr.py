"""Columns out of serialised messages (CDR), without an object a message.

The bytes that decide where everything lies in a message (lengths, and the names of joints) are
found by walking one message along its type; all messages with the same bytes there have the same
layout, so that numpy can take a field of thousands of them at once.
"""
from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import IntArray
from hydro_twin.recording.signals import NAME_FIELDS, split_index

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

ByteArray = npt.NDArray[np.uint8]

DTYPES = {
    'bool': 'u1', 'byte': 'u1', 'octet': 'u1', 'char': 'u1', 'int8': 'i1', 'uint8': 'u1',
    'int16': 'i2', 'uint16': 'u2', 'int32': 'i4', 'uint32': 'u4', 'int64': 'i8', 'uint64': 'u8',
    'float32': 'f4', 'float64': 'f8',
}
HEADER = 4   # bytes of encapsulation, from the end of which alignment counts


class CdrError(Exception):
    """A message is damaged, or does not hold a field."""


class Leaf(NamedTuple):
    """Where numbers lie in a message: `elements` of them, or None for a single one."""

    offset: int
    dtype: str
    elements: int | None


@dataclass
class Layout:
    """Where everything lies in messages that agree with one message in the `fixed` bytes."""

    payload: bytes
    fixed: list[tuple[int, int]] = field(default_factory=list)
    leaves: dict[str, Leaf] = field(default_factory=dict)
    names: dict[str, list[str]] = field(default_factory=dict)

    @cached_property
    def positions(self) -> IntArray:
        """Positions of the fixed bytes."""
        return np.concatenate([np.arange(begin, end) for begin, end in self.fixed])

    def fits(self, rows: ByteArray) -> npt.NDArray[np.bool_]:
        """Say which of the messages, one a row, have this layout."""
        if rows.shape[1] != len(self.payload):
            return np.zeros(len(rows), bool)
        expected = np.frombuffer(self.payload, np.uint8)[self.positions]
        fitting: npt.NDArray[np.bool_] = (rows[:, self.positions] == expected).all(axis=1)
        return fitting

    def leaf(self, path: str) -> Leaf | None:
        """Find one number; None where the joint asked for is not in these messages.

        Raises:
            CdrError: there is no such field, or it has too few elements.
        """
        if path in self.leaves and self.leaves[path].elements is None:
            return self.leaves[path]
        head, index = split_index(path)
        leaf = self.leaves.get(head)
        if index is None or leaf is None or leaf.elements is None:
            raise CdrError(f'has no number {path!r}; it has {", ".join(self.spelled())}')
        if index.isdecimal():
            element = int(index)
        else:
            parent = head[:head.rfind('.') + 1]
            names = next((self.names[parent + n] for n in NAME_FIELDS if parent + n in self.names),
                         None)
            if names is None:
                raise CdrError(f'names no joints beside {head!r}: write {head}[0]')
            if index not in names:
                return None
            element = names.index(index)
        if element >= leaf.elements:
            raise CdrError(f'has {leaf.elements} numbers in {head!r}, so no {path}')
        return Leaf(leaf.offset + element * int(leaf.dtype[2]), leaf.dtype, None)

    def spelled(self) -> list[str]:
        """Spell the fields as a user would ask for them."""
        return [path + ('' if leaf.elements is None else
                        f'[0..{leaf.elements - 1}]' if leaf.elements else '[] (empty)')
                for path, leaf in self.leaves.items()]


def lay_out(payload: bytes, msgtype: str, typestore: Typestore) -> Layout:
    """Walk one message along its type.

    Bytes after its end are ignored: rclpy's `serialize_message`, by which Python scripts write
    bags, leaves some there.

    Raises:
        CdrError: the message is damaged, that is, too short for what it says it holds.
    """
    walk = _Walk(payload, typestore)
    walk.message(msgtype, '')
    return walk.layout


class _Walk:
    """The state of a walk along one message."""

    def __init__(self, payload: bytes, typestore: Typestore) -> None:
        if len(payload) < HEADER or payload[0] != 0 or payload[1] not in (0, 1):
            raise CdrError('is damaged: it does not begin as CDR does')
        self.layout = Layout(payload, [(0, HEADER)])
        self.typestore = typestore
        self.order = '<' if payload[1] else '>'
        self.at = HEADER

    def skip(self, size: int, align: int = 1) -> int:
        """Step over a value, return where it begins."""
        begin = self.at + (HEADER - self.at) % align
        self.at = begin + size
        if self.at > len(self.layout.payload):
            raise CdrError(f'is damaged: it ends at byte {len(self.layout.payload)}, '
                           f'before its contents do')
        return begin

    def length(self) -> int:
        """Read a length, which fixes the layout."""
        begin = self.skip(4, 4)
        self.layout.fixed.append((begin, begin + 4))
        size = self.layout.payload[begin:begin + 4]
        return int.from_bytes(size, 'little' if self.order == '<' else 'big')

    def message(self, msgtype: str, prefix: str) -> None:
        """Walk all fields of a message."""
        for name, (kind, about) in self.typestore.fielddefs[msgtype][1]:
            self.field(int(kind), about, f'{prefix}{name}')

    def field(self, kind: int, about: Any, path: str) -> None:
        """Walk one field; kinds and descriptions are those of `rosbags.interfaces.Nodetype`."""
        if kind in (3, 4):   # array, sequence
            (item_kind, item), size = about
            self.elements(int(item_kind), item, path, size if kind == 3 else self.length())
        elif kind == 2:   # message
            self.message(about, f'{path}.')
        elif about[0] == 'string':
            self.text()
        else:
            self.numbers(about[0], path, None)

    def elements(self, kind: int, about: Any, path: str, count: int) -> None:
        """Walk the elements of an array or sequence."""
        if kind == 2:
            for index in range(count):
                self.message(about, f'{path}[{index}].')
        elif about[0] == 'string':
            self.layout.names[path] = [self.text(fixed=True) for _ in range(count)]
        else:
            self.numbers(about[0], path, count)

    def numbers(self, base: str, path: str, count: int | None) -> None:
        """Note a number or an array of numbers."""
        if base not in DTYPES:
            raise CdrError(f'has a field {path!r} of type {base}, which is not supported')
        dtype = self.order + DTYPES[base]
        size = int(dtype[2])
        begin = self.at if count == 0 else self.skip(size * (1 if count is None else count), size)
        self.layout.leaves[path] = Leaf(begin, dtype, count)

    def text(self, fixed: bool = False) -> str:
        """Step over a string; the layout hangs on its length, and on its letters if fixed."""
        size = self.length()
        begin = self.skip(size)
        if not fixed:
            return ''
        self.layout.fixed.append((begin, begin + size))
        return self.layout.payload[begin:begin + max(size - 1, 0)].decode('utf-8', 'replace')


class Batch(NamedTuple):
    """Messages of one topic as they lie in a file: message i is data[begin[i]:][:length[i]]."""

    received: IntArray   # receive times [ns]
    data: ByteArray
    begin: IntArray
    length: IntArray

    def rows(self, which: IntArray) -> ByteArray:
        """Copy out messages of one length, one a row."""
        windows = np.lib.stride_tricks.sliding_window_view(self.data, self.length[which[0]])
        return windows[self.begin[which]]


class Columns(NamedTuple):
    """Fields of a batch of messages; `present` says where a joint or field was there."""

    values: Mapping[str, npt.NDArray[Any]]
    present: Mapping[str, npt.NDArray[np.bool_]]


class Extractor:
    """Takes the same fields out of batch after batch of messages of one type."""

    def __init__(self, msgtype: str, typestore: Typestore, paths: Sequence[str],
                 optional: Collection[str] = ()) -> None:
        """Take `paths`; those of them that are `optional` need not be in a message."""
        self.msgtype = msgtype
        self.typestore = typestore
        self.paths = paths
        self.optional = optional
        self.layout: Layout | None = None

    def take(self, batch: Batch) -> Columns:
        """Take the fields out of one batch.

        Raises:
            CdrError: a message is damaged or lacks a field; `args[1]` is its index in the batch.
        """
        count = len(batch.received)
        values = {path: np.zeros(count) for path in self.paths}
        present = {path: np.zeros(count, bool) for path in self.paths}
        for length in np.unique(batch.length):
            which = np.flatnonzero(batch.length == length)
            if length == 0:
                raise CdrError('is empty', int(which[0]))
            rows = batch.rows(which)
            while len(which):
                layout = self._layout(rows[0], int(which[0]))
                fitting = layout.fits(rows)
                for path in self.paths:
                    try:
                        leaf = layout.leaf(path)
                    except CdrError as error:
                        if path in self.optional:
                            continue
                        raise CdrError(*error.args, int(which[0])) from None
                    if leaf is not None:
                        size = int(leaf.dtype[2])
                        taken = rows[fitting, leaf.offset:leaf.offset + size]
                        values[path][which[fitting]] = taken.view(leaf.dtype)[:, 0]
                        present[path][which[fitting]] = True
                rows, which = rows[~fitting], which[~fitting]
        return Columns(values, present)

    def joints(self) -> str:
        """List the names of joints in the messages seen last."""
        names = self.layout.names.values() if self.layout else ()
        return ', '.join(name for group in names for name in group) or 'not named'

    def _layout(self, row: ByteArray, index: int) -> Layout:
        """Return the layout of a message; most often it is that of the one before."""
        if self.layout is None or not self.layout.fits(row[None]).all():
            try:
                self.layout = lay_out(row.tobytes(), self.msgtype, self.typestore)
            except CdrError as error:
                raise CdrError(*error.args, index) from None
        return self.layout
