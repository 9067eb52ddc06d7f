"""The overhead of the engine, and its speed-up: traces by Dask against the same in plain loops.

    uv run --group dev python -m benchmarks.fleet [--traces 8] [--rounds 3]

Four ways to do the same traces, one after another in every round, each round beginning with
another of them, so that the load of the machine falls on all: a plain loop in one process; Dask
with one worker; two plain loops side by side in two processes, half of the traces each, as by a
shell; Dask with two workers. All processes are warm, do each trace on one core, and call the same
function. All traces are of one bag, so that two halves take the same time. What the engine takes
to start is timed apart, and so are tasks that are found done, where nothing but the overhead is
left. Beside the clock's is the processor time of a trace in its process, which the load of the
machine changes less. The results of all ways are compared.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
import contextlib
from contextlib import ExitStack
import io
import json
import multiprocessing
import os
from pathlib import Path
from statistics import mean, median
import sys
import tempfile
from time import perf_counter, process_time

from hydro_twin.commands.main import main as hydro_twin
from hydro_twin.fleet.engine import dask_executor, work
from hydro_twin.fleet.manifest import read_manifest, Task
from hydro_twin.fleet.task import run

PLANT = 'control_valve'         # whose recordings of 200 samples are traced in a few seconds
QUICK = 200                     # tasks that are found done, for the overhead of one
WAYS = ('1 loop', '1 worker', '2 loops', '2 workers')
type Item = tuple[Task, Path]   # a trace, and the folder for its result


def main() -> int:
    """Time, and print; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--traces', type=int, default=8, help='of a round, an even number')
    parser.add_argument('--rounds', type=int, default=3)
    args = parser.parse_args()
    print(f'load of the machine at the beginning: {os.getloadavg()[0]:.1f}')
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        (task,) = recorded(folder, [''])
        ways, start = begun(stack)
        print(f'start of the engine with two workers: {start:.1f} s')
        for way, trace in ways.items():             # imports and compiled code
            trace([(task, folder / 'warm' / way / str(k)) for k in range(int(way[0]))])
        times: dict[str, list[float]] = {way: [] for way in WAYS}
        processor: dict[str, list[float]] = {way: [] for way in WAYS}
        beside = []             # processor time of client and scheduler, by that of the clock
        for turn in range(args.rounds):
            for way in (*WAYS[turn % 4:], *WAYS[:turn % 4]):
                items = [(task, folder / f'{turn}' / way / str(k)) for k in range(args.traces)]
                begin, used = perf_counter(), process_time()
                processor[way] += ways[way](items)
                times[way].append(perf_counter() - begin)
                if way == '2 workers':
                    beside.append((process_time() - used) / times[way][-1])
        results = kept(folder)
        warm = sum(int(way[0]) for way in WAYS)
        if len(results) != len(WAYS) * args.rounds * args.traces + warm or any(
                one != results[0] for one in results):
            print('the results differ')
            return 1
        report(times, args.traces)
        print('processor time of a trace, mean: ' + ', '.join(
            f'{way} {mean(of_traces):.3f} s' for way, of_traces in processor.items()))
        print(f'client and scheduler beside two workers: {100 * median(beside):.1f} % of a core')
        again = [(task, folder / '0' / WAYS[0] / '0')] * QUICK
        for way in WAYS[:2]:
            begin = perf_counter()
            ways[way](again)
            print(f'{QUICK} tasks that are found done, {way}: '
                  f'{(perf_counter() - begin) / QUICK * 1e3:.1f} ms each')
    print(f'load of the machine at the end: {os.getloadavg()[0]:.1f}')
    return 0


def begun(stack: ExitStack) -> tuple[dict[str, Callable[[list[Item]], list[float]]], float]:
    """Start the processes of all ways, which end with the stack.

    Returns:
        The ways, by name, and what the engine with two workers took to start [s].
    """
    loops = [stack.enter_context(ProcessPoolExecutor(1, multiprocessing.get_context('spawn')))
             for _ in range(2)]
    one = stack.enter_context(dask_executor('', 1, lambda _: None))
    begin = perf_counter()
    two = stack.enter_context(dask_executor('', 2, lambda _: None))
    start = perf_counter() - begin
    return {'1 loop': lambda items: by_loops(items, loops[:1]),
            '1 worker': lambda items: by_engine(items, one),
            '2 loops': lambda items: by_loops(items, loops),
            '2 workers': lambda items: by_engine(items, two)}, start


def recorded(folder: Path, effects: Sequence[str]) -> list[Task]:
    """Simulate a bag with each effect, '' of a rig without; returns their tasks."""
    for k, effect in enumerate(effects):
        with contextlib.redirect_stdout(io.StringIO()):
            hydro_twin(['simulate', '--plant', PLANT, '--noise', '5e-3', '--duration', '200',
                        '--excitation', 'command=steps', '--seed', str(k),
                        *(('--effect', effect) if effect else ()),
                        '-o', str(folder / f'bag_{k}')])
    rows = [f'rig {k},{PLANT},bag_{k}' for k in range(len(effects))]
    (folder / 'fleet.csv').write_text('\n'.join(['name,plant,bags', *rows]), encoding='utf-8')
    return read_manifest(folder / 'fleet.csv')


def traced(item: Item) -> float:
    """Trace, or find that it is done; returns the processor time of the process meanwhile [s]."""
    task, folder = item
    begin = process_time()
    run(task, folder, 0)
    return process_time() - begin


def in_a_loop(items: list[Item]) -> list[float]:
    """Trace one after another; returns the processor times."""
    return [traced(item) for item in items]


def by_loops(items: list[Item], processes: list[ProcessPoolExecutor]) -> list[float]:
    """Trace in as many loops side by side as there are processes; returns the processor times."""
    futures = [process.submit(in_a_loop, items[k::len(processes)])
               for k, process in enumerate(processes)]
    return [one for future in futures for one in future.result()]


def by_engine(items: list[Item], engine: Executor) -> list[float]:
    """Trace by the engine; returns the processor times."""
    found = []
    for _, came in work(traced, items, engine):
        if isinstance(came, BaseException):
            raise came
        found.append(came)
    return found


def report(times: dict[str, list[float]], traces: int) -> None:
    """Print the times [s] of a trace, and their ratios round by round."""
    for way, of_rounds in times.items():
        print(f'{way}: {median(of_rounds) / traces:.3f} s a trace ('
              f'{", ".join(f"{one / traces:.3f}" for one in of_rounds)})')
    for what, over, under in (('overhead, 1 worker against 1 loop', '1 worker', '1 loop'),
                              ('overhead, 2 workers against 2 loops', '2 workers', '2 loops'),
                              ('speed-up, 2 loops against 1', '1 loop', '2 loops'),
                              ('speed-up, 2 workers against 1', '1 worker', '2 workers')):
        ratios = [a / b for a, b in zip(times[over], times[under], strict=True)]
        print(f'{what}: {median(ratios):.3f} ({", ".join(f"{one:.3f}" for one in ratios)})')


def kept(folder: Path) -> list[dict[str, object]]:
    """Read the results below a folder, without their times."""
    return [{**json.loads(path.read_text(encoding='utf-8')), 'seconds': 0}
            for path in folder.rglob('result.json')]


if __name__ == '__main__':
    sys.exit(main())
