"""Signals out of the serialised messages of one topic, as fast as they come."""
from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
import struct
from typing import Any

from hydro_twin.live.messages import typestore
from hydro_twin.recording.bag import STAMP
from hydro_twin.recording.cdr import CdrError, lay_out, Layout, Leaf
from hydro_twin.recording.signals import SignalMap

Values = Sequence[float | None]
CODES = {'u1': 'B', 'i1': 'b', 'u2': 'H', 'i2': 'h', 'u4': 'I', 'i4': 'i', 'u8': 'Q', 'i8': 'q',
         'f4': 'f', 'f8': 'd'}   # numpy's name of a type -> struct's


class Reader:
    """Reads the stamp and some signals of each message of a topic.

    Messages of one topic nearly always look alike, so where things lie is found out once and only
    checked after that: six times cheaper than deserialising the message.
    """

    def __init__(self, signals: Sequence[SignalMap], optional: Collection[SignalMap] = ()) -> None:
        """Read signals that are all on one topic, so of one type; a message may lack some."""
        self._signals, self._optional = signals, optional
        self._scaled = any(s.scale != 1.0 or s.offset != 0.0 for s in signals)
        self._size = -1
        self._fixed: list[tuple[slice, bytes]] = []
        self._values: Callable[[bytes], Values] = _unpacker([])
        self._stamp: Callable[[bytes], Sequence[int]] | None = None

    def read(self, payload: bytes) -> tuple[int | None, Values]:
        """Read one message.

        Returns:
            Header stamp [ns], None if the type has none; the signals in the units of the plant,
            None where the joint asked for is not in this message, or an optional field.

        Raises:
            CdrError: the message is damaged, or too short for a field.
        """
        if len(payload) != self._size:
            self._learn(payload)
        for where, expected in self._fixed:
            if payload[where] != expected:
                self._learn(payload)
                break
        values = self._values(payload)
        if self._scaled:
            values = [None if v is None else s.of(v)
                      for s, v in zip(self._signals, values, strict=True)]
        if self._stamp is None:
            return None, values
        seconds, nanoseconds = self._stamp(payload)
        return seconds * 1_000_000_000 + nanoseconds, values

    def _learn(self, payload: bytes) -> None:
        """Find out where everything lies in messages like this one."""
        self._size = -1
        layout = lay_out(payload, self._signals[0].type, typestore())
        self._values = _unpacker([self._leaf(layout, signal) for signal in self._signals])
        stamp = [layout.leaves.get(path) for path in STAMP]
        self._stamp = _unpacker(stamp) if all(stamp) else None
        self._fixed = [(slice(begin, end), payload[begin:end])
                       for begin, end in _joined(layout.fixed)]
        self._size = len(payload)

    def _leaf(self, layout: Layout, signal: SignalMap) -> Leaf | None:
        """Find a signal; None where it is not in these messages, and need not be."""
        try:
            return layout.leaf(signal.field)
        except CdrError:
            if signal in self._optional:
                return None
            raise


def _unpacker(leaves: Sequence[Leaf | None]) -> Callable[[bytes], Any]:
    """Make a function that takes numbers out of a message; None where there is no leaf."""
    parts = [(struct.Struct(leaf.dtype[0] + CODES[leaf.dtype[1:]]).unpack_from, leaf.offset)
             if leaf else None for leaf in leaves]
    return lambda payload: [part and part[0](payload, part[1])[0] for part in parts]


def _joined(ranges: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join ranges that touch."""
    joined: list[tuple[int, int]] = []
    for begin, end in sorted(ranges):
        if joined and begin <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(end, joined[-1][1]))
        else:
            joined.append((begin, end))
    return joined
