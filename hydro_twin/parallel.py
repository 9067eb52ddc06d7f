"""Work spread over the cores, in processes.

The worker processes are fresh interpreters, never forks: a fork of a process that has threads may
inherit a lock that nobody will release. They start with the first work that is worth it, or when
it is known that there will be some, wait for more, and end with their parent. They run nothing of
the caller's main program, so that a script needs no guard and a notebook works.
"""
from __future__ import annotations

import atexit
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
import io
from multiprocessing.connection import Connection, Pipe
import os
import pickle
from queue import Empty, SimpleQueue
import subprocess
import sys
from threading import Condition, local, Thread
from time import perf_counter
import traceback
from typing import Any

from hydro_twin.blas import ENVIRONMENT, one_thread
from hydro_twin.errors import WorkerError

WORTH = 2.0             # s of work left above which starting workers pays: about what one costs
LULL = 0.1              # s without work after which a worker imports what it may need later


def in_processes[T, R](function: Callable[[T], R], arguments: Sequence[T]) -> Iterator[R]:
    """Call a function for each argument in several processes; yield the results in their order.

    A fit of a usual recording spends half of its time in Python, where threads wait for one
    another. The caller works too: it takes the next item whenever the result that it is to yield
    is not there yet. So it waits only for items that a worker has begun, and another call before
    this one is exhausted cannot block. Results are those of one process.

    Args:
        function: of a module, or a partial of one, for workers to import. Where it or an argument
            cannot be pickled, or belongs to the main program, all is done in this process.
        arguments: of the calls.

    Raises:
        WorkerError: a worker ended by itself.
        Exception: what a call raised, in its turn.
    """
    rest = arguments
    if not _pool.workers:
        begin = perf_counter()
        for first in arguments[:1]:
            yield function(first)
        rest = arguments[1:]
        if (perf_counter() - begin) * len(rest) < WORTH:
            yield from map(function, rest)
            return
    job = None if _within.item or min(_cores(), len(rest)) < 2 else _job(function, rest)
    if job is None:
        yield from map(function, rest)
        return
    pool = _pool
    pool.begin(job, min(_cores() - 1, len(rest)))
    try:
        for k in range(len(rest)):
            yield pool.result(job, k)
    finally:
        pool.drop(job)


@contextmanager
def beside[T, R](function: Callable[[T], R], argument: T) -> Iterator[Callable[[], R]]:
    """Call a function in a worker while the caller does something else.

    Yields what returns its result. Where no worker is there, or none is free until that is asked
    for, the caller calls the function then.

    Args:
        function: of a module, or a partial of one, as for `in_processes`.
        argument: of the call.
    """
    pool = _pool
    job = _job(function, [argument]) if pool.workers and not _within.item else None
    if job is None:
        yield lambda: function(argument)
        return
    pool.begin(job)
    try:
        yield lambda: pool.result(job, 0)
    finally:
        pool.drop(job)


def prepare(module: str, later: str) -> None:
    """Start the workers of what will have work for all cores, so that they are ready in time.

    Args:
        module: that they import at once.
        later: one that they import as soon as they have nothing to do.
    """
    if not _within.item:
        _pool.start(_cores() - 1, module, later)


def _cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0))


class _Within(local):
    """Whether this thread is at work on an item of a job: then it spreads nothing itself."""

    item = False


_within = _Within()


@contextmanager
def on_one_core() -> Iterator[None]:
    """Keep to one core: what this thread calls within spreads nothing, nor does BLAS.

    For the tasks of an engine that has as many workers as there are cores.
    """
    before, _within.item = _within.item, True
    try:
        with one_thread():
            yield
    finally:
        _within.item = before


class _Failure:
    """What a call raised."""

    def __init__(self, error: Exception) -> None:
        self.error = error


def _call(function: Callable[[Any], Any], argument: Any) -> Any:
    """Call for one item; an exception is returned, to be raised when its turn comes."""
    _within.item = True
    try:
        return function(argument)
    except Exception as error:
        return _Failure(error)
    finally:
        _within.item = False


class _Job:
    """One call of `in_processes`: what is to be done, what nobody has taken, what is done.

    Attributes:
        packed: the function, pickled.
        items: the arguments, pickled.
        waiting: the items that nobody has taken.
        results: by item, until they are asked for.
        lost: why an item will never be done, if one will not.
        ours: whether workers cannot import what it takes.
    """

    def __init__(self, function: Callable[[Any], Any], arguments: Sequence[Any]) -> None:
        self.function = function
        self.arguments = arguments
        self.packed = _pickled(function)
        self.items = [_pickled(argument) for argument in arguments]
        self.waiting = deque(range(len(arguments)))
        self.results: dict[int, Any] = {}
        self.lost = ''
        self.ours = False


class _Pickler(pickle.Pickler):
    """Refuses what stands in the main program, which workers do not run."""

    def reducer_override(self, obj: Any) -> Any:
        """Refuse functions and classes of the main program; leave all else as it is."""
        if getattr(obj, '__module__', '') == '__main__' and hasattr(obj, '__qualname__'):
            raise pickle.PicklingError(f'{obj.__qualname__} is of the main program')
        return NotImplemented


def _pickled(value: Any) -> bytes:
    """Pickle for a worker."""
    file = io.BytesIO()
    _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(value)
    return file.getvalue()


def _job(function: Callable[[Any], Any], arguments: Sequence[Any]) -> _Job | None:
    """Make a job of a call; None if no other process could do it."""
    try:
        return _Job(function, arguments)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None


class _Worker:
    """A worker process, and the thread that hands it one item after another."""

    def __init__(self, pool: _Pool, module: str, later: str) -> None:
        self.pool = pool
        self.connection, there = Pipe()
        code = ('import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); '
                f'sys.path[:] = {sys.path!r}; import {module}; '
                f'from {__name__} import _serve; _serve({there.fileno()}, {later!r})')
        with there:
            self.process = subprocess.Popen(
                [sys.executable, '-c', code], pass_fds=[there.fileno()],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                env={**os.environ, **ENVIRONMENT})
        Thread(target=self.feed, name='feeds a worker', daemon=True).start()

    def feed(self) -> None:
        """Hand over items until the worker ends; whatever it had taken then is lost."""
        try:
            while True:
                self.work_on(self.pool.next_job())
        except (EOFError, OSError):
            pass
        finally:
            self.process.kill()
            self.pool.lost(self)
            self.connection.close()

    def work_on(self, job: _Job) -> None:
        """Do what is left of a job; it takes nothing before it is ready to begin at once."""
        self.connection.send_bytes(b'')
        self.connection.send_bytes(job.packed)
        job.ours = not pickle.loads(self.connection.recv_bytes())
        while (item := self.pool.take(job, self)) is not None:
            self.connection.send_bytes(job.items[item])
            self.pool.done(job, item, _unpickled(self.connection.recv_bytes()), self)


class _Pool:
    """The workers of this process, and the jobs that they share with whoever calls."""

    def __init__(self) -> None:
        self.workers: list[_Worker] = []
        self.busy: dict[_Worker, _Job] = {}
        self.jobs: list[_Job] = []
        self.changed = Condition()

    def start(self, workers: int, module: str = __name__, later: str = '') -> None:
        """Start workers until there are so many, see `prepare`."""
        with self.changed:
            while len(self.workers) < workers:
                self.workers.append(_Worker(self, module, later))

    def begin(self, job: _Job, workers: int = 1) -> None:
        """Put up a job, for so many workers at least."""
        self.start(workers)
        with self.changed:
            self.jobs.append(job)
            self.changed.notify_all()

    def drop(self, job: _Job) -> None:
        """Take a job back; what a worker is doing of it will not be missed."""
        with self.changed:
            job.waiting.clear()
            self.jobs.remove(job)

    def next_job(self) -> _Job:
        """Wait for a job of which something is left to take."""
        with self.changed:
            while True:
                for job in self.jobs:
                    if job.waiting and not job.ours:
                        return job
                self.changed.wait()

    def take(self, job: _Job, worker: _Worker) -> int | None:
        """Take an item of a job for a worker; None if nothing is left."""
        with self.changed:
            if not job.waiting or job.ours:
                return None
            self.busy[worker] = job
            return job.waiting.popleft()

    def done(self, job: _Job, item: int, outcome: Any, worker: _Worker | None = None) -> None:
        """Take in what came of an item."""
        with self.changed:
            job.results[item] = outcome
            if worker:
                del self.busy[worker]
            self.changed.notify_all()

    def lost(self, worker: _Worker) -> None:
        """Take note that a worker has ended, and lost what it had taken."""
        status = worker.process.wait()
        with self.changed:
            self.workers.remove(worker)
            if job := self.busy.pop(worker, None):
                job.lost = (f'a worker process ended by itself (status {status}); if it was '
                            'killed for want of memory, free some and try again')
            self.changed.notify_all()

    def result(self, job: _Job, k: int) -> Any:
        """Return what came of an item, working on this or on later ones until it is there."""
        while True:
            with self.changed:
                while not (k in job.results or job.waiting or job.lost):
                    self.changed.wait()
                if k in job.results:
                    outcome = job.results.pop(k)
                    break
                if job.lost:
                    raise WorkerError(job.lost)
                item = job.waiting.popleft()
            self.done(job, item, _call(job.function, job.arguments[item]))
        if isinstance(outcome, _Failure):
            raise outcome.error
        return outcome


_pool = _Pool()


def _end() -> None:
    """End all workers of this process."""
    for worker in list(_pool.workers):
        worker.process.kill()
        worker.process.wait()


def _forget() -> None:
    """Leave the workers to the parent, in a fork that somebody else made."""
    global _pool
    for worker in _pool.workers:
        worker.connection.close()
        worker.process.returncode = 0       # it is no child of this process
    _pool = _Pool()


atexit.register(_end)
os.register_at_fork(after_in_child=_forget)


def _unpickled(packed: bytes) -> Any:
    """Unpickle what came of an item, or of reading one."""
    try:
        return pickle.loads(packed)
    except Exception as error:
        return _Failure(error)


def _serve(descriptor: int, later: str) -> None:
    """Work for the parent at the other end of a pipe, until it ends.

    Args:
        descriptor: of the pipe.
        later: a module to import as soon as there is nothing to do, if any.
    """
    connection = Connection(descriptor)
    messages: SimpleQueue[bytes] = SimpleQueue()
    Thread(target=_listen, args=(connection, messages), daemon=True).start()
    function: Any = None
    while True:
        try:
            message = messages.get(timeout=LULL if later else None)
        except Empty:
            import_module(later)
            later = ''
            continue
        if message:
            argument = _unpickled(message)
            outcome = argument if isinstance(argument, _Failure) else _call(function, argument)
        else:
            function = _unpickled(messages.get())
            outcome = not isinstance(function, _Failure)
        try:
            connection.send_bytes(_answer(outcome))
        except OSError:
            os._exit(1)


def _answer(outcome: Any) -> bytes:
    """Pickle what came of an item; of an error, with where it arose."""
    if isinstance(outcome, _Failure):
        outcome.error.add_note(''.join(traceback.format_exception(outcome.error)))
    try:
        return pickle.dumps(outcome)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        return pickle.dumps(_Failure(TypeError(str(error))))


def _listen(connection: Connection, messages: SimpleQueue[bytes]) -> None:
    """Take in messages at any time, so as to end with the parent even amid an item."""
    try:
        while True:
            messages.put(connection.recv_bytes())
    except (EOFError, OSError):
        os._exit(1)
