"""What a worker of the local cluster does as it starts (Dask calls this a preload)."""
from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:    # noqa: ARG001
    """Leave Ctrl-C to the process that started the cluster, which ends the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
