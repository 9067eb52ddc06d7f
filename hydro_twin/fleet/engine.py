"""Hands tasks to an engine: Dask by default, or any executor of `concurrent.futures`.

What Dask does here is its own: workers that die are started again, and what they held is done by
others (https://distributed.dask.org/en/stable/resilience.html).
"""
from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import as_completed, CancelledError, Executor, Future
from contextlib import contextmanager, ExitStack
import logging
import os
from typing import Any

from hydro_twin.errors import UserError

RETRIES = 1             # of a task that raises
DEATHS = 1              # of workers that a task outlives; at the next it is given up
CONNECT = '10s'         # to wait for a scheduler
# Until a worker that died is taken off the cluster for good, and tasks fail since none is left. A
# new one is there in seconds, but on a machine with much else to do not in the 15 s of Dask.
PATIENCE = '10 minutes'
# Dask checks 50 times a second whether its event loops are late, and 10 times how much memory is
# left, in every worker and beside them, which takes time from the traces. These take seconds, so
# that it is enough to look every other second (an event loop is called late from 3 s on).
SELDOM = {'distributed.worker.profile.enabled': False, 'distributed.admin.tick.interval': '2s',
          'distributed.admin.tick.cycle': '10s',
          'distributed.worker.memory.monitor-interval': '2s',
          'distributed.admin.system-monitor.interval': '10s',
          'distributed.client.scheduler-info-interval': '1 minute'}
# A worker keeps 3 kB of each task in its logs, up to the last 1000 events. They lie in between the
# memory of the traces, which cannot be given back then. Nobody reads them here.
LOGS = dict.fromkeys(('distributed.admin.log-length', 'distributed.admin.low-level-log-length',
                      'distributed.admin.system-monitor.log-length'), 10)
# Which of these has the traceback of a lost connection depends on what was under way.
LOGGERS = ('distributed.client', 'tornado.application', 'asyncio')
PRELOAD = 'hydro_twin.fleet.worker'


@contextmanager
def dask_executor(scheduler: str, workers: int | None, say: Callable[[str], None]
                  ) -> Iterator[Executor]:
    """Start a local cluster, or join one that is there; it ends with the context.

    Args:
        scheduler: address of a scheduler, as 'tcp://10.0.0.1:8786'; '' for a local cluster.
        workers: processes of the local cluster, of one thread each; None: one a core.
        say: called with the address of the dashboard, and the number of workers that are there.

    Raises:
        ModuleNotFoundError: Dask is not installed.
        UserError: there is no scheduler at the address.
    """
    import dask
    from distributed import Client, LocalCluster

    settings = {'distributed.scheduler.allowed-failures': DEATHS,
                'distributed.scheduler.no-workers-timeout': PATIENCE,
                'distributed.deploy.lost-worker-timeout': PATIENCE, **SELDOM, **LOGS}
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        stack.enter_context(_quiet())
        if scheduler:
            try:
                client = Client(scheduler, timeout=CONNECT)
            except (OSError, ValueError) as error:
                raise UserError(f'no Dask scheduler at {scheduler}: {error}') from error
        else:
            cluster = stack.enter_context(LocalCluster(
                n_workers=workers or len(os.sched_getaffinity(0)), threads_per_worker=1,
                processes=True, host='127.0.0.1', dashboard_address='127.0.0.1:0',
                preload=[PRELOAD], silence_logs=logging.CRITICAL))
            client = Client(cluster)
        stack.enter_context(client)
        say(f'dashboard: {client.dashboard_link}, workers: {len(client.nthreads())}')
        executor = client.get_executor(pure=False, retries=RETRIES)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the tracebacks of a lost scheduler from standard error; `run` says it in a line."""
    loggers = [logging.getLogger(name) for name in LOGGERS]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def work[T, R](function: Callable[[T], R], items: Sequence[T], executor: Executor
               ) -> Generator[tuple[int, R | BaseException]]:
    """Call a function for each item; yield its index and what came of it, as each is done.

    Dask counts the death of a worker against every task that the worker held, also those that
    only waited there. So those that it gives up are tried once more, one at a time: then only
    one that kills its worker by itself is lost.

    Args:
        function: of a module, or a partial of one.
        items: the arguments.
        executor: does it.
    """
    waiting: dict[Future[R], int] = {}
    suspects = []
    try:
        for k, item in enumerate(items):
            try:
                waiting[executor.submit(function, item)] = k
            except RuntimeError as error:       # a pool that broke meanwhile
                yield k, error
        for future in as_completed(waiting):
            # Not kept here, since a worker of Dask keeps a result for as long as its future is.
            k, outcome = waiting.pop(future), outcome_of(future)
            if _gave_up(outcome):
                suspects.append(k)
            else:
                yield k, outcome
        for k in suspects:
            future = executor.submit(function, items[k])
            waiting[future] = k
            yield k, outcome_of(future)
    finally:
        for future in waiting:
            future.cancel()


def outcome_of(future: Future[Any]) -> Any:
    """Wait for a future; return its result, or what it raised."""
    try:
        return future.exception() or future.result()
    except CancelledError as error:
        return error


def reason(error: BaseException) -> str:
    """Say on one line why a task has no result."""
    if _gave_up(error):
        return ('its worker process died each time, also when it had this trace only: was it '
                'killed, or is memory short?')
    said = ' '.join(str(error).split())
    return said if isinstance(error, UserError) else f'{type(error).__name__}: {said}'


def _gave_up(outcome: Any) -> bool:
    """Whether Dask gave a task up since its workers died; without importing Dask."""
    return type(outcome).__name__ == 'KilledWorker'
