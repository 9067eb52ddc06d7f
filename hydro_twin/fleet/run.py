"""Traces a fleet: manifest in, results, tables and page out."""
from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Executor
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.fleet import store
from hydro_twin.fleet.engine import dask_executor, reason, work
from hydro_twin.fleet.manifest import read_manifest
from hydro_twin.fleet.summary import summarise
from hydro_twin.fleet.tables import write_tables
from hydro_twin.fleet.task import Outcome, run

PAUSE = 5.0             # s between two lines on the progress


def trace_fleet(manifest: Path | str, folder: Path | str, *, executor: Executor | None = None,
                scheduler: str = '', workers: int | None = None, seed: int = 0,
                say: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Trace every rig of a manifest in every period, and write tables and page.

    What an earlier run has done for the same bags, configuration and version is not done again.

    Args:
        manifest: CSV or YAML (docs/fleet.md).
        folder: for fleet.html, fleet.json, fleet.parquet and results/.
        executor: of `concurrent.futures`, which stays open; None: Dask.
        scheduler: address of a Dask scheduler; '' for a local cluster.
        workers: of the local cluster; None: one a core.
        seed: of the random numbers.
        say: called with the progress, a line at a time.

    Returns:
        What fleet.json holds.

    Raises:
        ManifestError: the manifest has faults, one line each.
        UserError: the folder cannot be written, or there is no scheduler, or it is lost; the
            finished traces are kept then, but tables and page are not written.
        ModuleNotFoundError: Dask or pyarrow is not installed.
    """
    import pyarrow as _  # noqa: F401, ICN001    rather now than after all the traces

    tasks = read_manifest(Path(manifest))
    folder = Path(folder).resolve()
    if folder.exists() and not folder.is_dir():
        raise UserError(f'{folder}: is a file; a folder is needed for the results')
    say(f'{len({task.rig for task in tasks})} rigs, {len(tasks)} traces')
    outcomes: list[Outcome | None] = [None] * len(tasks)
    with ExitStack() as stack:
        stack.callback(store.sweep, folder)     # of workers that end with the engine
        engine = executor or stack.enter_context(dask_executor(scheduler, workers, say))
        try:
            (folder / store.RESULTS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f'{folder}: cannot be written ({error.strerror})') from error
        store.sweep(folder)
        there = store.keys(folder)
        tell = _Teller(len(tasks), say)
        for k, came in work(partial(run, folder=folder, seed=seed), tasks, engine):
            if isinstance(came, CancelledError):    # and so are all others that are not done
                raise UserError(f'{tell.count} of {len(tasks)} done, the rest cancelled: is the '
                                'Dask scheduler still there? The same command goes on from here')
            outcome = came if isinstance(came, Outcome) else Outcome(None, reason=reason(came))
            # Not as its worker saw it: a task that is repeated, since a worker died before it had
            # handed over what it held, finds what that had made.
            outcome = replace(outcome, traced=bool(outcome.key) and outcome.key not in there)
            there.add(outcome.key)
            outcomes[k] = outcome
            if outcome.record is None:
                say(f'{tasks[k].rig} {tasks[k].date}: {outcome.reason}')
            tell.one(outcome)
    done = [(task, outcome) for task, outcome in zip(tasks, outcomes, strict=True) if outcome]
    return write_tables(summarise(done), folder)


class _Teller:
    """Reports the progress of the traces, and their expected end."""

    def __init__(self, total: int, say: Callable[[str], None]) -> None:
        self.total, self.say = total, say
        self.count, self.traced, self.failed = 0, 0, 0
        self.begin = self.last = monotonic()

    def one(self, outcome: Outcome) -> None:
        """Count one, and say so now and then."""
        self.count += 1
        self.traced += outcome.traced
        self.failed += outcome.record is None
        now = monotonic()
        if self.count < self.total and now - self.last < PAUSE:
            return
        self.last = now
        parts = [f'{self.count} of {self.total} done']
        if found := self.count - self.traced - self.failed:
            parts.append(f'{found} found done')
        if self.failed:
            parts.append(f'{self.failed} failed')
        if self.count < self.total and self.traced:
            left = (now - self.begin) / self.traced * (self.total - self.count)
            parts.append(f'ends about {datetime.now() + timedelta(seconds=left):%d %b %H:%M:%S}')
        self.say(', '.join(parts))
