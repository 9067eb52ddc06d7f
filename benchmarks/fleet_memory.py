"""The memory of a worker of the engine over many traces, which should not grow.

    uv run --group dev python -m benchmarks.fleet_memory [--traces 100]

One worker traces ten short recordings, three of rigs with an effect, again and again into other
folders, so that every round runs the same code on the same data. After each round a task of its
own reads the resident memory of the worker. The slope is that of a straight line from the second
round on, since what a trace imports and compiles is there by then.
"""
from __future__ import annotations

import argparse
from functools import partial
import os
from pathlib import Path
import sys
import tempfile

import numpy as np

from benchmarks.fleet import recorded
from hydro_twin.fleet.engine import dask_executor, work
from hydro_twin.fleet.task import run

EFFECTS = ('backlash@stem:gap=0.03', 'saturation@stem:lower=-10,upper=0.6', 'delay@command:time=3')
RIGS = 10
EVERY = 3               # rig has an effect
WARM = 2                # rounds until all is imported and compiled


def main() -> int:
    """Trace, and print the memory; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--traces', type=int, default=100, help='30 at least')
    count = parser.parse_args().traces
    with tempfile.TemporaryDirectory() as name, dask_executor('', 1, lambda _: None) as engine:
        folder = Path(name)
        tasks = recorded(folder, [
            EFFECTS[k // EVERY % len(EFFECTS)] if k % EVERY == EVERY - 1 else ''
            for k in range(RIGS)])
        found = []
        for k in range(1, count // RIGS + 1):
            for _, came in work(partial(run, folder=folder / str(k), seed=0), tasks, engine):
                if isinstance(came, BaseException):
                    raise came
            process, memory = engine.submit(resident).result()
            found.append((k * RIGS, process, memory))
            print(f'{k * RIGS} traces: {memory / 2 ** 20:.1f} MiB', flush=True)
    if len({process for _, process, _ in found}) > 1:
        print('the worker was started anew')
        return 1
    traces, _, memories = zip(*found[WARM - 1:], strict=True)
    slope = np.polyfit(traces, memories, 1)[0]
    print(f'from {traces[0]} traces on: {slope / 1024:+.1f} KiB a trace')
    return 0


def resident() -> tuple[int, int]:
    """Return the id of this process, and its resident memory [B]."""
    pages = int(Path('/proc/self/statm').read_text(encoding='utf-8').split()[1])
    return os.getpid(), pages * os.sysconf('SC_PAGESIZE')


if __name__ == '__main__':
    sys.exit(main())
