"""A Dask scheduler and its workers, started as a user starts them: for tests and benchmarks."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
from contextlib import ExitStack
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import NamedTuple

LONGEST = 60.0          # [s] to wait for the scheduler
PLACE = 'scheduler.json'
LOG = 'cluster.log'


class Cluster(NamedTuple):
    """A cluster; each process leads a session of its own.

    Attributes:
        address: of the scheduler, for `--scheduler`.
        scheduler: its process.
        workers: a process each that starts the worker proper, and starts another if that dies.
    """

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextlib.contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    """Start a scheduler and workers of one thread each; kill them at the end of the context.

    Args:
        folder: for the address of the scheduler, what the processes say, and their own files.
        workers: how many.

    Raises:
        TimeoutError: the scheduler does not start.
    """
    place = folder / PLACE
    place.unlink(missing_ok=True)
    with ExitStack() as stack:
        log = stack.enter_context((folder / LOG).open('ab'))

        def start(*words: str) -> subprocess.Popen[bytes]:
            process = stack.enter_context(subprocess.Popen(
                [sys.executable, '-m', *words, '--scheduler-file', str(place)], stdout=log,
                stderr=log, start_new_session=True))
            stack.callback(kill_session, process)
            return process

        scheduler = start('distributed.cli.dask_scheduler', '--host', '127.0.0.1', '--port', '0',
                          '--dashboard-address', '127.0.0.1:0')
        members = [start('distributed.cli.dask_worker', '--nthreads', '1', '--no-dashboard',
                         '--preload', 'hydro_twin.fleet.worker', '--local-directory', str(folder))
                   for _ in range(workers)]
        end = time.monotonic() + LONGEST
        while not place.exists():
            if scheduler.poll() is not None or time.monotonic() > end:
                raise TimeoutError(f'no scheduler: see {folder / LOG}')
            time.sleep(0.02)
        address = json.loads(place.read_text(encoding='utf-8'))['address']
        yield Cluster(address, scheduler, members)


def kill_session(process: subprocess.Popen[bytes] | subprocess.Popen[str]) -> None:
    """Kill -9 all processes of a session, given its first."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
