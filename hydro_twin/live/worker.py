"""A thread for what must not keep a message waiting: a task at intervals, and jobs between."""
from __future__ import annotations

from collections.abc import Callable
import contextlib
import queue
import threading
import time

Job = Callable[[], object]


class Worker:
    """Runs a task every so often, and jobs as they come, one at a time."""

    def __init__(self, period: float, task: Callable[[float], object],
                 failed: Callable[[Exception], object]) -> None:
        """Start the thread.

        Args:
            period: of the task [s].
            task: takes the time since it last ran [s].
            failed: called with what a task or job raised; the thread goes on.
        """
        self._period = period
        self._task = task
        self._failed = failed
        self._jobs: queue.Queue[Job | None] = queue.Queue()
        self._ran = time.monotonic()
        self._thread = threading.Thread(target=self._work, name='worker', daemon=True)
        self._thread.start()

    def do(self, job: Job) -> None:
        """Have a job done."""
        self._jobs.put(job)

    def stop(self) -> None:
        """End the thread after the jobs that are queued; wait at most 5 s for it."""
        self._jobs.put(None)
        self._thread.join(timeout=5.0)

    def _work(self) -> None:
        while True:
            job: Job | None = self._run_task
            with contextlib.suppress(queue.Empty):
                job = self._jobs.get(timeout=max(self._ran + self._period - time.monotonic(), 0.0))
            if job is None:
                return
            try:
                job()
            except Exception as error:
                self._failed(error)

    def _run_task(self) -> None:
        elapsed, self._ran = time.monotonic() - self._ran, time.monotonic()
        self._task(elapsed)
