"""The overhead of the engine, and its speed-up: traces by Dask against the same in loops.

    uv run --group dev python -m benchmarks.fleet [--traces 8] [--rounds 3]

The same traces are done in six ways, one after another in every round. Each round begins with
another way, so that the load of the machine falls on all.

- shell: a loop of a shell, with a command `hydro-twin trace` for each trace;
- loop: a loop in a process that has all imported and compiled already;
- worker: Dask.

Each is done with one process, and with two at a time; of two loops each takes half of the traces.
Every process keeps to one core. All traces are of one bag, so that two halves take the same time.
What the engine takes to start is timed apart, and so are tasks that are found done, where nothing
but the overhead is left.

Beside the time by the clock is the processor time of a trace, which the load of the machine
changes less: that of its process, and that of client and scheduler. The results of all ways are
compared.
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
import resource
import shlex
from statistics import median
import subprocess
import sys
import tempfile
from time import perf_counter, process_time

from hydro_twin.commands.main import main as hydro_twin
from hydro_twin.fleet.engine import dask_executor, work
from hydro_twin.fleet.manifest import read_manifest, Task
from hydro_twin.fleet.store import RESULTS
from hydro_twin.fleet.task import command_of, run

PLANT = 'control_valve'         # whose recordings of 200 samples are traced in a few seconds
QUICK = 200                     # tasks that are found done, for the overhead of one
WAYS = ('1 shell', '1 loop', '1 worker', '2 shells', '2 loops', '2 workers')
RATIOS = {'overhead, 1 worker against a shell': ('1 worker', '1 shell'),
          'overhead, 2 workers against two shells': ('2 workers', '2 shells'),
          'overhead, 1 worker against a loop': ('1 worker', '1 loop'),
          'overhead, 2 workers against two loops': ('2 workers', '2 loops'),
          'speed-up, two loops against one': ('1 loop', '2 loops'),
          'speed-up, 2 workers against one': ('1 worker', '2 workers')}
type Item = tuple[Task, Path]   # a trace, and the folder for its result
type Way = Callable[[list[Item]], list[float]]      # does traces; their processor times [s]


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
        for way in WAYS:                            # imports and compiled code
            ways[way]([(task, folder / 'warm' / way / str(k)) for k in range(int(way[0]))])
        times: dict[str, list[float]] = {way: [] for way in WAYS}
        processor: dict[str, list[float]] = {way: [] for way in WAYS}
        client: dict[str, list[float]] = {way: [] for way in WAYS}
        for turn in range(args.rounds):
            for way in (*WAYS[turn % len(WAYS):], *WAYS[:turn % len(WAYS)]):
                items = [(task, folder / str(turn) / way / str(k)) for k in range(args.traces)]
                begin, used = perf_counter(), process_time()
                processor[way] += ways[way](items)
                times[way].append((perf_counter() - begin) / args.traces)
                client[way].append((process_time() - used) / args.traces)
        results = kept(folder)
        warm = sum(int(way[0]) for way in WAYS)
        if len(results) != len(WAYS) * args.rounds * args.traces + warm or any(
                one != results[0] for one in results):
            print('the results differ')
            return 1
        report(times, processor, client)
        again = [(task, folder / '0' / '1 loop' / '0')] * QUICK
        for way in ('1 loop', '1 worker'):
            begin = perf_counter()
            ways[way](again)
            print(f'{QUICK} tasks that are found done, {way}: '
                  f'{(perf_counter() - begin) / QUICK * 1e3:.1f} ms each')
    print(f'load of the machine at the end: {os.getloadavg()[0]:.1f}')
    return 0


def begun(stack: ExitStack) -> tuple[dict[str, Way], float]:
    """Start the processes of all ways, which end with the stack.

    Returns:
        The ways, by name, and what the engine with two workers took to start [s].
    """
    from distributed import default_client

    loops = [stack.enter_context(ProcessPoolExecutor(1, multiprocessing.get_context('spawn')))
             for _ in range(2)]
    begin = perf_counter()
    two = stack.enter_context(dask_executor('', 2, lambda _: None))
    start = perf_counter() - begin
    client = default_client()
    one = client.get_executor(pure=False, workers=[next(iter(client.nthreads()))])
    return {'1 shell': lambda items: by_shells(items, 1), '1 loop': lambda items: by_loops(
                items, loops[:1]), '1 worker': lambda items: by_engine(items, one),
            '2 shells': lambda items: by_shells(items, 2), '2 loops': lambda items: by_loops(
                items, loops), '2 workers': lambda items: by_engine(items, two)}, start


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


def by_shells(items: list[Item], count: int) -> list[float]:
    """Trace by commands, in so many shells side by side; returns the mean of the processor times.

    Each shell has a core to itself, since `trace` spreads over all that it may use.
    """
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    shells = []
    for k, core in zip(range(count), sorted(os.sched_getaffinity(0)), strict=False):
        script = '\n'.join(['set -e', *(command(item) for item in items[k::count])])
        shells.append(subprocess.Popen(['taskset', '-c', str(core), 'sh', '-c', script],
                                       stdout=subprocess.DEVNULL))
    statuses = [shell.wait() for shell in shells]
    if any(statuses):
        sys.exit('a command failed')
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    mean = (now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime) / len(items)
    return [mean] * len(items)


def command(item: Item) -> str:
    """Write the command of a trace, into the folder where the engine would leave its files."""
    task, folder = item
    words = shlex.split(command_of(task, 0))
    return shlex.join([sys.executable, '-m', 'hydro_twin.commands.main', *words[1:-1],
                       str(folder / RESULTS / 'trace')])


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


def report(times: dict[str, list[float]], processor: dict[str, list[float]],
           client: dict[str, list[float]]) -> None:
    """Print medians of the times of a trace [s], and of their ratios round by round.

    Args:
        times: by the clock, of each way and round.
        processor: of the process of a trace, of each way and trace.
        client: of this process, which is client and scheduler, of each way and round.
    """
    for way, of_rounds in times.items():
        print(f'{way}: {median(of_rounds):.3f} s a trace '
              f'({", ".join(f"{one:.3f}" for one in of_rounds)}), processor '
              f'{median(processor[way]):.3f} s and {median(client[way]):.3f} s beside')
    for what, (over, under) in RATIOS.items():
        ratios = [a / b for a, b in zip(times[over], times[under], strict=True)]
        print(f'{what}: {median(ratios):.3f} ({", ".join(f"{one:.3f}" for one in ratios)})')
    for workers, loops in (('1 worker', '1 loop'), ('2 workers', '2 loops')):
        own, of_loops = median(processor[workers]), median(processor[loops])
        beside = median(client[workers]) - median(client[loops])
        print(f'processor time, {workers} against {loops}: {own / of_loops:.3f}, with client and '
              f'scheduler {(own + beside) / of_loops:.3f}')


def kept(folder: Path) -> list[dict[str, object]]:
    """Read the reports of all traces below a folder."""
    return [json.loads(path.read_text(encoding='utf-8')) for path in folder.rglob('report.json')]


if __name__ == '__main__':
    sys.exit(main())
