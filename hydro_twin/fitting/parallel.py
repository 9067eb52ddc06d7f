"""Work spread over the cores: on threads for long compiled runs, else in processes."""
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
import os
import signal
from threading import Thread
from typing import Any
import warnings

_call: Callable[[int], Any] | None = None       # of a worker process


def in_threads[T, R](function: Callable[[T], R], arguments: Sequence[T]) -> list[R]:
    """Call a function for each argument on threads: the kernel does not hold Python's lock."""
    if _workers(arguments) < 2:
        return [function(argument) for argument in arguments]
    with ThreadPoolExecutor(_workers(arguments)) as pool:
        return list(pool.map(function, arguments))


def in_processes[T, R](function: Callable[[T], R], arguments: Sequence[T]) -> Iterator[R]:
    """Call a function for each argument in processes and yield the results, in their order.

    A fit of a usual recording spends half of its time in Python, where threads wait for one
    another. The processes are forks: the function and its arguments, with their compiled laws,
    are there already, and need not be picklable. The results must be.
    """
    if _workers(arguments) < 2:
        yield from map(function, arguments)
        return
    with ProcessPoolExecutor(_workers(arguments), get_context('fork'), _begin,
                             (lambda k: function(arguments[k]),)) as pool:
        with warnings.catch_warnings():
            # Of other threads; the calls take none of the locks that those might hold.
            warnings.filterwarnings('ignore', '.*use of fork', DeprecationWarning)
            results = pool.map(_do, range(len(arguments)))      # forks
        yield from results


def _workers(arguments: Sequence[Any]) -> int:
    """Count what may work at once; a worker has no workers of its own."""
    return 1 if _call is not None else min(len(os.sched_getaffinity(0)), len(arguments))


def _begin(call: Callable[[int], Any]) -> None:
    """Make ready a worker, which leaves an interrupt to its parent, and ends when that does."""
    global _call
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    _call = call


def _end_with_parent() -> None:
    """Wait for the parent to end, then end."""
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def _do(k: int) -> Any:
    """Call for one argument in a worker."""
    assert _call is not None
    return _call(k)
