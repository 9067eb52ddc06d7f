"""What a worker of Dask does besides its tasks (Dask calls this a preload)."""
from __future__ import annotations

import gc
import signal
from typing import Any

from distributed import Worker, WorkerPlugin

DONE = 'memory'         # what Dask calls the state of a task whose result is there


class Freeze(WorkerPlugin):     # type: ignore[misc]    # it has no types
    """Keeps the garbage collector off what the first task leaves behind: imports, compiled code.

    That is some 250,000 objects, none of which is ever garbage. A full collection looks through
    all, in a tenth of a second, every few traces.
    """

    def __init__(self) -> None:
        self.frozen = False

    def transition(self, key: object, start: str, finish: str, **_: Any) -> None:   # noqa: ARG002
        """Freeze once, when a task has come to its result."""
        if finish == DONE and not self.frozen:
            self.frozen = True
            gc.collect()        # what is garbage by now would stay for good
            gc.freeze()


async def dask_setup(worker: Worker) -> None:
    """Leave Ctrl-C to the process that started the cluster, which ends the worker, and freeze."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    await worker.plugin_add(Freeze())
