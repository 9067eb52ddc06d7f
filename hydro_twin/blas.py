"""BLAS on one thread, for work on matrices of some ten columns.

There, threads that wait for one another cost many times what they give: `benchmarks/engine.py` has
the ratio.
"""
from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from threading import Lock
from typing import Any

# For a process that has not loaded its BLAS yet: it then starts no threads at all.
ENVIRONMENT: Mapping[str, str] = {'OPENBLAS_NUM_THREADS': '1'}


class _Limit:
    """The limit of this process, and who is within: BLAS has one number of threads for all."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.users = 0
        self.limited: Any = None


_limit = _Limit()


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep BLAS to one thread; once nobody is within any more, it has as many as before."""
    from threadpoolctl import threadpool_limits

    with _limit.lock:
        if not _limit.users:
            _limit.limited = threadpool_limits(1, 'blas')
        _limit.users += 1
    try:
        yield
    finally:
        with _limit.lock:
            _limit.users -= 1
            if not _limit.users:
                _limit.limited.restore_original_limits()
