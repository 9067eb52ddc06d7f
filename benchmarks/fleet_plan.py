"""What a large fleet would take, on paper, from what a small one took.

    uv run --group dev python -m benchmarks.fleet_plan out/study/out [--rigs 10000 --workers 64]

From the results of a fleet: the size of what a trace leaves, and its time, unless that is given;
from `benchmarks.fleet`, what the engine adds to a task. Measured now, in processor time, since
the clock says little where a machine is busy: what comparison and page take for a tenth of the
rigs.
"""
from __future__ import annotations

import argparse
import json
from pathlib import Path
from statistics import mean
import sys
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.page import page
from hydro_twin.fleet.store import RECORD, RESULTS
from hydro_twin.fleet.summary import summarise
from hydro_twin.fleet.task import Outcome

ENGINE = 0.0047         # [s] that the engine adds to a task: 7.7 less 3.0 ms, by benchmarks.fleet
GROUP = 50              # rigs of a type
SCATTER = 0.05          # of their estimates


class Tables(NamedTuple):
    """What comparison and page took [s], and how large the page is."""

    comparison: float
    page: float
    size: int


def main() -> int:
    """Measure, and print the plan."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('folder', type=Path, help='that the verb fleet has written')
    parser.add_argument('--rigs', type=int, default=10_000)
    parser.add_argument('--workers', type=int, default=64)
    parser.add_argument('--seconds', type=float, help='of a trace (default: as in the results)')
    args = parser.parse_args()
    paths = sorted((args.folder / RESULTS).glob(f'*/{RECORD}'))
    records = [json.loads(path.read_text(encoding='utf-8')) for path in paths]
    if not records:
        sys.exit(f'{args.folder}: no results')
    trace = args.seconds or mean(record['seconds'] for record in records)
    size = mean(sum(file.stat().st_size for file in path.parent.rglob('*') if file.is_file())
                for path in paths)
    sent = mean(path.stat().st_size for path in paths)
    print(f'a trace: {trace:.1f} s, {size / 1e3:.0f} kB on disk, {sent / 1e3:.1f} kB to the '
          f'scheduler')
    tenth = of_tables(records, args.rigs // 10)
    print(f'{args.rigs // 10} rigs in groups of {GROUP}: comparison {tenth.comparison:.1f} s, '
          f'page {tenth.page:.1f} s and {tenth.size / 1e6:.1f} MB')
    busy = args.workers * ENGINE / trace
    print(f'{args.rigs} rigs on {args.workers} workers: traces '
          f'{args.rigs * trace / args.workers / 60:.0f} min, comparison and page '
          f'{10.0 * (tenth.comparison + tenth.page) / 60:.1f} min; the engine is busy for '
          f'{100 * busy:.1f} % of the time, and would be all of it with {trace / ENGINE:.0f} '
          f'workers; {args.rigs * size / 1e9:.1f} GB of results, {args.rigs * sent / 1e6:.0f} MB '
          f'through the scheduler, a page of {10 * tenth.size / 1e6:.0f} MB')
    return 0


def of_tables(records: list[dict[str, Any]], rigs: int) -> Tables:
    """Measure comparison and page of so many rigs, made up of the results there are."""
    rng = np.random.default_rng(0)
    done = []
    for k in range(rigs):
        record = json.loads(json.dumps(records[k % len(records)]))
        for name, one in record['estimates'].items():
            moved = float(np.exp(SCATTER * rng.normal()))
            one['value'] *= moved
            if name in record['factor']['names']:
                record['factor']['values'][record['factor']['names'].index(name)] *= moved
        done.append((Task(f'rig {k}', 'control_valve', (), '2026-01-01', False, None, (),
                          f'type {k // GROUP}', ()), Outcome(record, key=f'{k:032x}')))
    begin = process_time()
    fleet = summarise(done)
    middle = process_time()
    text = page(fleet)
    return Tables(middle - begin, process_time() - middle, len(text.encode()))


if __name__ == '__main__':
    sys.exit(main())
