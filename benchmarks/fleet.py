"""The overhead of the engine: traces by `trace_fleet` against the same in a plain loop.

    uv run --group dev python -m benchmarks.fleet [--traces 8]

Both do every trace on one core in one process that is warm, and in turns, so that the load of the
machine falls on both. The loop calls what the worker calls. What the engine takes to start and to
end is timed apart. The results of both are compared first.
"""
from __future__ import annotations

import argparse
from concurrent.futures import Executor
import contextlib
from functools import partial
import io
import json
from pathlib import Path
from statistics import median
import sys
import tempfile
from time import perf_counter

from hydro_twin.commands.main import main as hydro_twin
from hydro_twin.fleet.engine import dask_executor, work
from hydro_twin.fleet.manifest import read_manifest, Task
from hydro_twin.fleet.task import Outcome, run

PLANT = 'control_valve'         # whose recordings of 200 samples are traced in about a second
QUICK = 200                     # tasks that are found done, for the overhead of one


def main() -> int:
    """Time, and print; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--traces', type=int, default=8)
    count = parser.parse_args().traces
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tasks = recorded(folder, count)
        begin = perf_counter()
        with dask_executor('', 1, lambda _: None) as engine:
            by_engine(tasks[:1], folder / 'first', engine)
            by_loop(tasks[:1], folder / 'first_loop')
            print(f'start of the engine, with the imports of its worker: '
                  f'{perf_counter() - begin:.1f} s')
            turns = []
            for k, task in enumerate(tasks):
                times = {}
                for how in (('loop', 'engine'), ('engine', 'loop'))[k % 2]:
                    begin = perf_counter()
                    if how == 'loop':
                        by_loop([task], folder / 'loop')
                    else:
                        by_engine([task], folder / 'engine', engine)
                    times[how] = perf_counter() - begin
                turns.append(times)
            if kept(folder / 'loop') != kept(folder / 'engine'):
                print('the results differ')
                return 1
            ratio = median(times['engine'] / times['loop'] for times in turns)
            print(f'{count} traces, median of one: loop {median(t["loop"] for t in turns):.2f} s, '
                  f'engine {median(t["engine"] for t in turns):.2f} s, ratio {ratio:.3f}')
            again = [tasks[k % count] for k in range(QUICK)]
            begin = perf_counter()
            by_loop(again, folder / 'loop')
            middle = perf_counter()
            by_engine(again, folder / 'engine', engine)
            end = perf_counter()
            print(f'{QUICK} tasks that are found done, of one: '
                  f'loop {(middle - begin) / QUICK * 1e3:.1f} ms, '
                  f'engine {(end - middle) / QUICK * 1e3:.1f} ms')
    return 0


def recorded(folder: Path, count: int) -> list[Task]:
    """Simulate bags; returns their tasks."""
    for k in range(count):
        with contextlib.redirect_stdout(io.StringIO()):
            hydro_twin(['simulate', '--plant', PLANT, '--noise', '5e-3', '--duration', '200',
                        '--excitation', 'command=steps', '--seed', str(k),
                        '-o', str(folder / f'bag_{k}')])
    rows = [f'rig {k},{PLANT},bag_{k}' for k in range(count)]
    (folder / 'fleet.csv').write_text('\n'.join(['name,plant,bags', *rows]), encoding='utf-8')
    return read_manifest(folder / 'fleet.csv')


def by_loop(tasks: list[Task], folder: Path) -> list[Outcome]:
    """Trace one after another."""
    return [run(task, folder, 0) for task in tasks]


def by_engine(tasks: list[Task], folder: Path, engine: Executor) -> list[Outcome]:
    """Trace by the engine."""
    came = dict(work(partial(run, folder=folder, seed=0), tasks, engine))
    found = [came[k] for k in range(len(tasks))]
    return [one for one in found if isinstance(one, Outcome)]


def kept(folder: Path) -> dict[str, dict[str, object]]:
    """Read the results of a folder, without their times."""
    return {path.parent.name: {**json.loads(path.read_text(encoding='utf-8')), 'seconds': 0}
            for path in (folder / 'results').glob('*/result.json')}


if __name__ == '__main__':
    sys.exit(main())
