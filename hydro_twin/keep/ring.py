"""The last messages of some topics in memory, as they came."""
from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field

SECOND = 1_000_000_000
OVERHEAD = 200      # bytes that Python takes for a message beside its content
Message = tuple[int, str, bytes]    # receive time [ns], topic, content


@dataclass
class _Topic:
    """The messages of one topic: (steady time [ns], receive time [ns], content)."""

    latched: bool = False
    messages: deque[tuple[int, int, bytes]] = field(default_factory=deque)


class Ring:
    """Keeps messages by time, within a bound in bytes.

    Of each topic the last message from before the window stays as well: it gives what a command
    at rest was. All messages of latched topics stay, however old. The bound in bytes overrides
    both: beyond it the oldest messages go, those of latched topics last.

    Attributes:
        size: bytes held, with what Python takes for each message.
        dropped: messages that the bound in bytes has cost.
    """

    def __init__(self, seconds: float, most: int) -> None:
        """Keep this long, and no more than so many bytes."""
        self.seconds = seconds
        self.most = most
        self.size = 0
        self.dropped = 0
        self._topics: dict[str, _Topic] = {}
        self._held: int | None = None

    def latch(self, topic: str) -> None:
        """Keep all messages of a topic from now on."""
        self._topics.setdefault(topic, _Topic()).latched = True

    def hold(self, since: int | None) -> None:
        """Keep all from a steady time on [ns], however long ago; None: the window again."""
        self._held = since

    def add(self, topic: str, now: int, received: int, content: bytes) -> None:
        """Take in a message; `now` is by a clock that never goes back [ns]."""
        one = self._topics.get(topic)
        if one is None:
            one = self._topics.setdefault(topic, _Topic())
        one.messages.append((now, received, content))
        self.size += len(content) + OVERHEAD
        since = self._since(now)
        while not one.latched and len(one.messages) > 1 and one.messages[1][0] <= since:
            self._drop(one)
        while self.size > self.most and self._drop_oldest():
            self.dropped += 1

    def clear(self) -> None:
        """Forget all but latched topics, as where the clock of the stamps has jumped back."""
        for one in self._topics.values():
            while not one.latched and one.messages:
                self._drop(one)

    def stretch(self, since: int) -> list[Message]:
        """List what came from a steady time on [ns], and what stays from before it, in order."""
        found: list[Message] = []
        for topic, one in self._topics.items():
            messages = list(one.messages)
            first = 0
            if not one.latched:
                first = bisect_left(messages, since, key=lambda message: message[0])
                if first == len(messages) or messages[first][0] > since:
                    first = max(first - 1, 0)
            found += [(received, topic, content) for _, received, content in messages[first:]]
        return sorted(found, key=lambda message: message[0])

    def latched(self) -> set[str]:
        """Name the latched topics."""
        return {topic for topic, one in self._topics.items() if one.latched}

    def span(self) -> float:
        """Return how far back the ring reaches on all topics that are not latched [s]."""
        ends = [(one.messages[0][0], one.messages[-1][0]) for one in self._topics.values()
                if one.messages and not one.latched]
        return (max(end for _, end in ends) - max(begin for begin, _ in ends)) / SECOND \
            if ends else 0.0

    def _since(self, now: int) -> int:
        begin = now - round(self.seconds * SECOND)
        return begin if self._held is None else min(begin, self._held)

    def _drop(self, one: _Topic) -> None:
        self.size -= len(one.messages.popleft()[2]) + OVERHEAD

    def _drop_oldest(self) -> bool:
        """Drop one message; False where but one is left."""
        full = [one for one in self._topics.values() if one.messages]
        if sum(len(one.messages) for one in full) <= 1:
            return False
        self._drop(min(full, key=lambda one: (one.latched, one.messages[0][0])))
        return True
