"""Locates the fault behind a rise of the residual: keeps the newest samples, works in a thread."""
from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
import sys
from threading import Lock, Thread

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.live.location import Location
from hydro_twin.live.monitor import Rise
from hydro_twin.model import Model

LEAD = 500      # samples before the fault, in which the observer finds the states: 1 s at 500 Hz
EARLY = 250     # of these, by how many a fault may set in before the batch in which it shows
SPAN = 2500     # samples of the fault that are waited for: 5 s at 500 Hz, some strokes of a rig
HELD_BACK = 10.0    # longest that an event waits for them [s]: a slow plant has fewer samples
LEAST = 250     # samples of the fault without which nothing is located: a law has 17 unknowns
# How often the thread gives way to the hot path [s]: a tenth of a sample at 500 Hz. By default
# Python's threads take turns of 5 ms.
YIELD = 0.0002
KEPT = 2 * (LEAD + SPAN)        # newest samples: those of a rise, a batch of it and the wait


class _Turns:
    """How often the threads of this process take turns, which belongs to all locators."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._users = 0
        self._usual = 0.0       # [s]

    @contextmanager
    def short(self) -> Iterator[None]:
        """Keep turns at `YIELD` until the last of those who want that is done."""
        with self._lock:
            if not self._users:
                self._usual = sys.getswitchinterval()
                sys.setswitchinterval(YIELD)
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    sys.setswitchinterval(self._usual)


_turns = _Turns()


class Locator:
    """The newest samples of a twin in mode observer, and where the fault of a rise enters.

    `add` is for the hot path and only keeps; `located` is for another thread, and starts one
    that takes seconds.
    """

    def __init__(self, model: Model) -> None:
        """Keep samples of a model with its noise."""
        self._model = model
        self._samples: deque[tuple[int, FloatArray, float]] = deque(maxlen=KEPT)
        self._rise: Rise | None = None
        self._newest = 0
        self._thread: Thread | None = None
        self._found = Location()

    def add(self, stamp: int, inputs: FloatArray, measured: float) -> None:
        """Keep a sample."""
        self._samples.append((stamp, inputs.copy(), measured))

    def clear(self) -> None:
        """Forget the samples: those that come do not follow them."""
        self._samples.clear()

    def take(self, rise: Rise) -> None:
        """Take on a rise."""
        self._rise = rise

    @property
    def at_work(self) -> bool:
        """Whether a location is being found."""
        return self._thread is not None

    def located(self) -> Rise | None:
        """Return the rise with its location once that is found; to be asked now and then.

        It waits for `SPAN` samples of the fault, or `HELD_BACK`, or until no more come.
        """
        if self._rise is None:
            return None
        if self._thread is None:
            samples = list(self._samples)           # at once: the other thread cannot interrupt
            newest = samples[-1][0] if samples else 0
            settled = self._rise.settled
            if (sum(stamp > settled for stamp, *_ in samples) < SPAN and newest != self._newest
                    and newest - settled < 1e9 * HELD_BACK):
                self._newest = newest
                return None
            self._thread = Thread(target=self._locate, args=(self._rise, samples), daemon=True)
            self._thread.start()
        if self._thread.is_alive():
            return None
        found = replace(self._rise, location=self._found)
        self._rise, self._thread, self._found = None, None, Location()
        return found

    def _locate(self, rise: Rise, samples: list[tuple[int, FloatArray, float]]) -> None:
        """Find the location, for `located`, and give way to the hot path meanwhile."""
        with _turns.short():
            self._found = self._location(rise, samples)

    def _location(self, rise: Rise, samples: list[tuple[int, FloatArray, float]]) -> Location:
        """Cut the stretch that a rise is about, and locate the fault in it."""
        # Imported when it is needed, since it compiles derivatives.
        from hydro_twin.live.locate import locate

        stamps = np.array([stamp for stamp, *_ in samples])
        first, last = np.searchsorted(stamps, [rise.begin, rise.settled])
        begin = first - EARLY - LEAD
        if begin < 0:                   # the fault is older than the samples
            begin, first, last = max(len(samples) - SPAN, 0), 0, 0
        else:
            first, last = first - EARLY - begin, last - begin
        if len(samples) - begin - last < LEAST:
            return Location()
        return locate(self._model, np.array([inputs for _, inputs, _ in samples[begin:]]),
                      np.array([measured for *_, measured in samples[begin:]]), int(first),
                      int(last))
