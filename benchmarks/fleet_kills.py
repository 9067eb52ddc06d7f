"""Kills a worker, the scheduler or the whole of a fleet's run at random moments, and repeats it.

    uv run --group dev python -m benchmarks.fleet_kills [--kills 12 --rigs 6]

The verb `fleet` traces short recordings by a Dask scheduler and two workers, processes each. At a
random moment one worker, the scheduler, or all of them with the verb are killed by SIGKILL. After
a worker the verb must end by itself. After the others the same command is given once more, with a
new scheduler and new workers. Then results and tables must be those of an undisturbed run, and no
trace may have been begun again that was not running. Which process begins which trace is read off
the folders of unfinished results.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import json
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
import tempfile
from threading import Event, Thread
import time
from typing import Any

from benchmarks.dask_cluster import Cluster, cluster, kill_session
from benchmarks.fleet import recorded
from hydro_twin.fleet.store import RESULTS

WORKERS = 2
VICTIMS = ('worker', 'scheduler', 'whole')
LONGEST = 240.0         # [s] for a run


def main() -> int:
    """Kill, repeat, compare, and print; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--kills', type=int, default=12)
    parser.add_argument('--rigs', type=int, default=6)
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    draw = random.Random(args.seed)
    wrong = again = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recorded(folder, [''] * args.rigs)
        with cluster(folder, WORKERS) as found, watched(folder / 'whole') as begun:
            process = started(folder, folder / 'whole', found.address)
            wait_for_a_trace(process, begun)
            begin = time.monotonic()
            process.communicate(timeout=LONGEST)
            length = time.monotonic() - begin
        expected = outcome(folder / 'whole')
        print(f'undisturbed: {len(expected["results"])} traces in {length:.1f} s', flush=True)
        for k in range(args.kills):
            out = folder / f'out_{k}'
            victim, delay = VICTIMS[k % len(VICTIMS)], draw.uniform(0.0, length)
            with watched(out) as begun:
                done, running = disturbed(folder, out, victim, delay, begun)
                same = outcome(out) == expected
            repeated = len(begun) - len(expected['results'])
            well = same and repeated <= running
            wrong += not well
            again += repeated
            print(f'{victim}, {delay:.1f} s after the first trace began, {done} done, {running} '
                  f'running: {"the same" if same else "ANOTHER"} result, {repeated} begun again',
                  flush=True)
    print(f'{args.kills} kills, {args.kills - wrong} with the same result and only running traces '
          f'begun again, {again} in all')
    return 1 if wrong else 0


def disturbed(folder: Path, out: Path, victim: str, delay: float, begun: set[tuple[str, ...]]
              ) -> tuple[int, int]:
    """Run, kill, and complete.

    Returns:
        How many traces were done at the kill, and how many were lost to it.
    """
    with cluster(folder, WORKERS) as found:
        process = started(folder, out, found.address)
        wait_for_a_trace(process, begun)
        time.sleep(delay)
        done = len(list((out / RESULTS).glob('[!.]*')))
        running = kill(victim, found, process, out)
        process.communicate(timeout=LONGEST)
    if process.returncode:
        with cluster(folder, WORKERS) as found:
            process = started(folder, out, found.address)
            process.communicate(timeout=LONGEST)
    return done, running


def kill(victim: str, found: Cluster, process: subprocess.Popen[str], out: Path) -> int:
    """Kill; returns how many traces may be lost with it: one a worker, if it has begun."""
    if victim == 'worker':
        for part in unfinished(out):
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(part[2]), signal.SIGKILL)
                return 1
        return 0
    running = len(unfinished(out))
    for one in (found.scheduler, *((*found.workers, process) if victim == 'whole' else ())):
        kill_session(one)
    return running


def started(folder: Path, out: Path, scheduler: str) -> subprocess.Popen[str]:
    """Start the verb, in a session of its own."""
    return subprocess.Popen(
        [sys.executable, '-m', 'hydro_twin.commands.main', 'fleet', str(folder / 'fleet.csv'),
         '-o', str(out), '--scheduler', scheduler], stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True, start_new_session=True)


def unfinished(out: Path) -> list[tuple[str, ...]]:
    """List the results that are being made: key, thread and process each."""
    return [tuple(part.name[1:].split('.', 3)[:3]) for part in (out / RESULTS).glob('.*.*.*.*')]


@contextlib.contextmanager
def watched(out: Path) -> Iterator[set[tuple[str, ...]]]:
    """Collect which process begins which trace."""
    stop = Event()
    begun: set[tuple[str, ...]] = set()

    def watch() -> None:
        while not stop.wait(0.01):
            begun.update(unfinished(out))

    thread = Thread(target=watch)
    thread.start()
    try:
        yield begun
    finally:
        stop.set()
        thread.join()


def wait_for_a_trace(process: subprocess.Popen[str], begun: set[tuple[str, ...]]) -> None:
    """Wait until a trace begins."""
    while not begun:
        if process.poll() is not None:
            sys.exit(process.communicate()[1])
        time.sleep(0.01)


def outcome(out: Path) -> dict[str, Any]:
    """Read all that a run has made, without times and what it found done."""
    records = {path.parent.name: json.loads(path.read_text(encoding='utf-8'))
               for path in (out / RESULTS).glob('[!.]*/result.json')}
    fleet = json.loads((out / 'fleet.json').read_text(encoding='utf-8'))
    fleet['traces'].pop('traced_now')
    for one in (*records.values(), *(one for rig in fleet['rigs'] for one in rig['periods'])):
        one.pop('seconds')
    return {'results': records, 'fleet': fleet}


if __name__ == '__main__':
    sys.exit(main())
