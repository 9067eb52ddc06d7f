"""When a stretch of the ring is captured, and how it gets onto the disk."""
from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, UTC
import json
from pathlib import Path
import shutil
from typing import TYPE_CHECKING

import yaml

from hydro_twin.errors import BagError
from hydro_twin.files import sync, write_whole
from hydro_twin.keep.ring import Message, Ring, SECOND
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.write import write_messages

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

BAG, TRACE, CONFIG, OUTCOME = 'bag', 'trace', 'config.yaml', 'outcome.json'
REASONS = 'captured'       # entry of the metadata of a bag: why it was captured
LONGEST = 10.0      # times `after`: for so long events may extend a capture


@dataclass(frozen=True)
class Wanted:
    """A stretch that is to be captured, on the steady clock [ns].

    Attributes:
        asked: when it was first asked for.
        why: by whom or what, one entry an event.
    """

    begin: int
    end: int
    asked: int
    why: tuple[str, ...]


@dataclass(frozen=True)
class Captured:
    """A stretch on the disk: the folder that holds the bag, and its SHA-256."""

    folder: Path
    sha256: str

    @property
    def bag(self) -> Path:
        """The bag."""
        return self.folder / BAG

    @property
    def why(self) -> list[str]:
        """By whom or what it was asked for, as the metadata of the bag say."""
        about = yaml.safe_load((self.bag / 'metadata.yaml').read_text('utf-8'))
        why: list[str] = json.loads(
            about['rosbag2_bagfile_information']['custom_data'][REASONS])
        return why


class Capture:
    """Decides what of a ring is captured; an event in the meantime extends it."""

    def __init__(self, ring: Ring) -> None:
        """Capture from a ring."""
        self.ring = ring
        self.wanted: Wanted | None = None

    def ask(self, now: int, after: float, why: str, since: int | None = None) -> None:
        """Have the ring captured, until some time from now.

        Args:
            now: steady time [ns].
            after: for how long still [s].
            why: who or what asks.
            since: when what is to be seen began [ns]; by default the stretch is the whole ring.
        """
        window = now - round(self.ring.seconds * SECOND)
        begin, end = max(since or window, window), now + round(after * SECOND)
        if self.wanted is None:
            self.wanted = Wanted(begin, end, now, (why,))
        else:
            latest = self.wanted.asked + round(LONGEST * after * SECOND)
            self.wanted = replace(self.wanted, begin=min(begin, self.wanted.begin),
                                  end=max(self.wanted.end, min(end, latest)),
                                  why=(*self.wanted.why, why))
        self.ring.hold(self.wanted.begin)

    def left(self, now: int) -> float:
        """Return how much is still to come [s]; 0 where nothing is wanted."""
        return max(self.wanted.end - now, 0) / SECOND if self.wanted else 0.0

    def take(self, now: int) -> tuple[Wanted, list[Message]] | None:
        """Give what was wanted once it is all there; None until then."""
        if self.wanted is None or now < self.wanted.end:
            return None
        wanted, self.wanted = self.wanted, None
        self.ring.hold(None)
        return wanted, self.ring.stretch(wanted.begin)


def write(folder: Path, wanted: Wanted, messages: list[Message],
          topics: Mapping[str, tuple[str, bool]], store: Typestore) -> Captured:
    """Write a stretch into a folder of its own, atomically.

    Args:
        folder: of all captures.
        wanted: why it was captured.
        messages: in the order of time.
        topics: name -> type, and whether it is latched.
        store: knows the types.

    Raises:
        BagError: nothing was captured, or the bag cannot be written.
        OSError: the disk does not allow it.
    """
    held = {topic for _, topic, _ in messages}
    if not held:
        raise BagError('nothing to capture: no message has come')
    name = datetime.now(UTC).strftime('%Y%m%dT%H%M%S.%fZ')
    folder.mkdir(parents=True, exist_ok=True)
    part, done = folder / f'.{name}', folder / name
    part.mkdir()
    try:
        write_messages(part / BAG, {topic: about for topic, about in topics.items()
                                    if topic in held}, messages, store,
                       {REASONS: json.dumps(wanted.why)})
        for path in (part / BAG).iterdir():
            sync(path)
        sync(part / BAG)
        part.rename(done)
        sync(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return Captured(done, source_of(done / BAG).sha256)


def untraced(folder: Path) -> list[Captured]:
    """List captures that were not traced to an end, the oldest first; clean up what was cut."""
    if not folder.is_dir():
        return []
    for left in folder.glob('.*'):
        shutil.rmtree(left, ignore_errors=True)
    return [Captured(one, source_of(one / BAG).sha256) for one in sorted(folder.iterdir())
            if (one / BAG).is_dir() and not (one / OUTCOME).exists()]


def close(captured: Captured, outcome: str) -> None:
    """Note what became of a capture, so that it is not traced again."""
    write_whole(captured.folder / OUTCOME, json.dumps({'outcome': outcome}) + '\n', durable=True)


def prune(folder: Path, most: int, kept: Collection[Path]) -> None:
    """Delete the oldest captures beyond a number, except some.

    Those stay that are not yet traced, and those whose bag is kept.

    Args:
        folder: of all captures.
        most: how many may stay.
        kept: bags that stay in any case.
    """
    there = sorted(one for one in folder.iterdir() if not one.name.startswith('.'))
    for one in there[:max(len(there) - most, 0)]:
        if (one / OUTCOME).exists() and one / BAG not in kept:
            shutil.rmtree(one, ignore_errors=True)
