"""Traces of small recordings, one after another, beside processes that keep the machine busy.

    python benchmarks/many_traces.py [--count 200] [--load 2] [--limit 600]

Every trace is a process of its own, as on the command line. One that does not end within the
limit fails, and so does one that ends with anything but a report; then so does the benchmark.
"""
from __future__ import annotations

import argparse
from dataclasses import replace
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from hydro_twin.plants import PLANTS
from hydro_twin.recording.rig import read, Rig, rig_of
from hydro_twin.recording.write import write_recording

BAGS = Path(__file__).parents[1] / 'bags'
SOURCES = [('load_simulator', 'rig_a'), ('load_simulator', 'rig_b'),
           ('valve_servo', 'valve_steps'), ('valve_servo', 'valve_limit')]
SAMPLES = 400           # of each of the series that are left of a bag
SERIES = 2
BUSY = 'while True: pass'


def main() -> int:
    """Trace, and say how it went; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--count', type=int, default=200, help='of traces')
    parser.add_argument('--load', type=int, default=2, help='processes that only compute')
    parser.add_argument('--limit', type=float, default=600.0, help='for one trace [s]')
    asked = parser.parse_args()
    busy = [subprocess.Popen([sys.executable, '-c', BUSY]) for _ in range(asked.load)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            bags = [(plant, small(plant, bag, Path(folder))) for plant, bag in SOURCES]
            return many(bags, asked.count, asked.limit, Path(folder))
    finally:
        for process in busy:
            process.kill()
            process.wait()


def small(name: str, bag: str, folder: Path) -> Path:
    """Cut a sample bag; returns the bag that is left of it."""
    rig: Rig = rig_of(PLANTS[name])
    series = read([BAGS / bag], rig).series[:SERIES]
    middle = [len(one) // 2 for one in series]
    write_recording(folder / bag, [replace(one.part(k, k + SAMPLES), source='')
                                   for one, k in zip(series, middle, strict=True)],
                    rig.signals, {})
    return folder / bag


def many(bags: list[tuple[str, Path]], count: int, limit: float, folder: Path) -> int:
    """Trace so many times; returns the exit status."""
    longest, failed = 0.0, 0
    for k in range(count):
        plant, bag = bags[k % len(bags)]
        begin = time.monotonic()
        ended = traced([str(bag), '--plant', plant, '-o', str(folder / f'out_{k}'), '--seed',
                        str(k)], limit)
        took = time.monotonic() - begin
        longest, failed = max(longest, took), failed + (ended != '')
        print(f'{k + 1} of {count}: {bag.name}, {took:.1f} s {ended}'.rstrip(), flush=True)
    print(f'{count - failed} of {count} traces ended well; the longest took {longest:.1f} s')
    return int(failed > 0)


def traced(arguments: list[str], limit: float) -> str:
    """Trace in a process of its own; returns what was wrong, or ''."""
    with subprocess.Popen(
            [sys.executable, '-m', 'hydro_twin.commands.main', 'trace', *arguments],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            start_new_session=True) as process:
        try:
            _, errors = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return f'HANGS: no end within {limit:g} s'
    return '' if process.returncode == 0 else f'FAILS ({process.returncode}): {errors.strip()}'


if __name__ == '__main__':
    sys.exit(main())
