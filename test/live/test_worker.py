"""The thread beside the hot path."""
from __future__ import annotations

import threading

from hydro_twin.live.worker import Worker


def test_the_task_runs_again_and_again_and_jobs_between() -> None:
    enough, done = threading.Event(), threading.Event()
    intervals: list[float] = []

    def task(elapsed: float) -> None:
        intervals.append(elapsed)
        if len(intervals) == 3:
            enough.set()

    worker = Worker(0.01, task, lambda error: None)
    worker.do(done.set)
    assert done.wait(10.0)
    assert enough.wait(10.0)
    worker.stop()
    assert min(intervals) >= 0.01
    assert 'worker' not in [thread.name for thread in threading.enumerate()]


def test_what_fails_is_told_and_ends_nothing() -> None:
    failures: list[Exception] = []
    done = threading.Event()
    worker = Worker(60.0, lambda elapsed: None, failures.append)
    worker.do(lambda: 1 / 0)
    worker.do(done.set)
    assert done.wait(10.0)
    worker.stop()
    assert [type(failure) for failure in failures] == [ZeroDivisionError]
