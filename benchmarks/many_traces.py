"""Traces of small recordings, one after another, beside processes that keep the machine busy.

    python benchmarks/many_traces.py [--count 200] [--load 2] [--limit 3600]

Ten traces at a time share a process and its workers, which are given all work there is, however
little it is: so workers start and end twenty times, and are handed many small jobs. Ten that do
not end within the limit fail, and so does one that ends with anything but a report; then so does
the benchmark. The limit is long, for a machine that others use too.
"""
from __future__ import annotations

import argparse
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from hydro_twin.commands.main import main as run

PLANT = 'control_valve'
SECONDS = 200           # of a recording at 1 Hz, which is traced in some seconds
SOURCES = 10            # recordings
EACH = 10               # traces of a process
BUSY = 'while True: pass'
WORK = f"""
import sys
from hydro_twin.commands.main import main
from hydro_twin import parallel
parallel.WORTH = 0.0
folder, *bags = sys.argv[1:]
for k, bag in enumerate(bags):
    if main(['trace', bag, '--plant', {PLANT!r}, '-o', f'{{folder}}/{{k}}', '--seed', str(k)]):
        sys.exit(1)
    print('traced', flush=True)
if not parallel._pool.workers:
    sys.exit('no work was spread: has this machine one core only?')
"""


def main() -> int:
    """Trace, and say how it went; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--count', type=int, default=200, help='of traces')
    parser.add_argument('--load', type=int, default=2, help='processes that only compute')
    parser.add_argument('--limit', type=float, default=3600.0, help=f'for {EACH} traces [s]')
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bags = [recorded(Path(folder), seed) for seed in range(SOURCES)]
        busy = [subprocess.Popen([sys.executable, '-c', BUSY]) for _ in range(asked.load)]
        try:
            return many(bags, asked.count, asked.limit, Path(folder))
        finally:
            for process in busy:
                process.kill()
                process.wait()


def recorded(folder: Path, seed: int) -> Path:
    """Simulate a bag, every other one of a valve with play."""
    bag = folder / f'bag_{seed}'
    effect = ['--effect', 'backlash@stem:gap=0.02'] if seed % 2 else []
    status = run(['simulate', '--plant', PLANT, '--noise', '5e-3', '--duration', str(SECONDS),
                  '--excitation', 'command=steps', '--seed', str(seed), *effect, '-o', str(bag)])
    assert status == 0
    return bag


def many(bags: list[Path], count: int, limit: float, folder: Path) -> int:
    """Trace so many times; returns the exit status."""
    longest, done, wrong = 0.0, 0, False
    for first in range(0, count, EACH):
        some = [bags[k % len(bags)] for k in range(first, min(first + EACH, count))]
        begin = time.monotonic()
        ended, said = traced(some, folder / f'out_{first}', limit)
        took = time.monotonic() - begin
        longest, done, wrong = max(longest, took), done + ended, wrong or said != ''
        print(f'{done} of {count}: {took:.1f} s {said}'.rstrip(), flush=True)
    print(f'{done} of {count} traces ended well; the longest {EACH} took {longest:.1f} s')
    return int(wrong)


def traced(bags: list[Path], folder: Path, limit: float) -> tuple[int, str]:
    """Trace in a process of its own; returns how many ended well, and what was wrong, or ''."""
    folder.mkdir()
    with subprocess.Popen([sys.executable, '-c', WORK, str(folder), *map(str, bags)],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          start_new_session=True) as process:
        try:
            out, errors = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return process.communicate()[0].count('traced\n'), f'HANGS: no end in {limit:g} s'
    fault = f'FAILS ({process.returncode}): {errors.strip()}' if process.returncode else ''
    return out.count('traced\n'), fault


if __name__ == '__main__':
    sys.exit(main())
