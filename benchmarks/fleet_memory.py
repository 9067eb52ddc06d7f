"""The memory of a worker of the engine over many traces, which should not grow.

    uv run --group dev python -m benchmarks.fleet_memory [--traces 200]

One worker traces ten short recordings, three of rigs with an effect, again and again into other
folders, so that every round runs the same code on the same data. After each round a task of its
own has the garbage collected and what is free given back to the system, and reads the resident
memory of the worker and the number of blocks that Python has allocated. Straight lines through
both begin with the second round, since what a trace imports and compiles is there by then.
"""
from __future__ import annotations

import argparse
import ctypes
from functools import partial
import gc
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
    parser.add_argument('--traces', type=int, default=200, help='50 at least')
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
            process, resident, blocks = engine.submit(memory).result()
            found.append((k * RIGS, process, resident, blocks))
            print(f'{k * RIGS} traces: {resident / 2 ** 20:.2f} MiB, {blocks} blocks, load of the '
                  f'machine {os.getloadavg()[0]:.1f}', flush=True)
    if len({process for _, process, _, _ in found}) > 1:
        print('the worker was started anew')
        return 1
    traces, _, resident, blocks = np.array(found[WARM - 1:]).T
    for values, scale, unit in ((resident, 1024, 'KiB'), (blocks, 1, 'blocks')):
        line, covariance = np.polyfit(traces, values / scale, 1, cov=True)
        print(f'from {traces[0]} traces on: {line[0]:+.2f} ± {covariance[0, 0] ** 0.5:.2f} {unit} '
              'a trace')
    return 0


def memory() -> tuple[int, int, int]:
    """Give back what is free; returns the id of this process, its resident memory [B], blocks."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path('/proc/self/statm').read_text(encoding='utf-8').split()[1])
    return os.getpid(), pages * os.sysconf('SC_PAGESIZE'), sys.getallocatedblocks()


if __name__ == '__main__':
    sys.exit(main())
