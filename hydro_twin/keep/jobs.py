"""Work that must not keep a message waiting: a thread a job, its result taken when asked for."""
from __future__ import annotations

from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any


class Jobs:
    """Runs jobs by name, no two of one name at once; what they give is handled in `poll`.

    Attributes:
        stop: set when all are to end.
    """

    def __init__(self) -> None:
        """Run nothing yet."""
        self.stop = Event()
        self._running: dict[str, Thread] = {}
        self._done: SimpleQueue[tuple[str, Callable[[], object]]] = SimpleQueue()

    def busy(self, name: str) -> bool:
        """Whether a job of that name runs, or has a result that was not handled."""
        return name in self._running

    def start[T](self, name: str, work: Callable[[], T], done: Callable[[T], object],
                 failed: Callable[[Exception], object]) -> None:
        """Start a job.

        Args:
            name: no job of that name may be busy.
            work: what it does, in a thread of its own.
            done: takes the result, in `poll`.
            failed: takes what was raised instead.
        """
        def run() -> None:
            try:
                result: Any = work()
            except Exception as error:
                self._done.put((name, lambda error=error: failed(error)))   # type: ignore[misc]
            else:
                self._done.put((name, lambda: done(result)))

        assert name not in self._running, f'{name} runs already'
        self._running[name] = Thread(target=run, name=name, daemon=True)
        self._running[name].start()

    def poll(self) -> None:
        """Handle what has been done since the last time."""
        while True:
            try:
                name, handle = self._done.get_nowait()
            except Empty:
                return
            self._running.pop(name).join()
            handle()

    def end(self, patience: float) -> None:
        """Have all jobs end, and wait for each no longer than this [s]."""
        self.stop.set()
        for thread in self._running.values():
            thread.join(patience)
