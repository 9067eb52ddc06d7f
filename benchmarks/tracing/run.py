"""Trace many rigs and write what came out, one JSON line a rig; resumes where it stopped.

python -m benchmarks.tracing.run -o out/tracing.jsonl
python -m benchmarks.tracing.run -o out/held_out.jsonl --seeds held_out --count 200
"""
from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed, ProcessPoolExecutor
import json
from multiprocessing import get_context
import os
from pathlib import Path
import time
import traceback
from typing import Any, TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress

from benchmarks.tracing.cases import BLOCK, case_of, cases, FIRST_SEED, KINDS, SEVERAL
from benchmarks.tracing.figures import read, report
from benchmarks.tracing.linear_fit import shows
from benchmarks.tracing.true_fit import error_on_test, shows_beside, true_fit
from hydro_twin.blas import ENVIRONMENT

if TYPE_CHECKING:
    from hydro_twin.plants import Plant
    from hydro_twin.recording.series import Recording

TraceOne = Callable[[int], dict[str, Any]]     # of a seed, to a line of results


def main() -> None:
    """Trace the cases that the file lacks, then print the figures of all in it."""
    asked = arguments(__doc__, KINDS, 52)
    seeds = asked.seed or [case.seed for kind in asked.kinds
                           for case in cases(asked.seeds, kind, asked.count)]
    complete(asked.output, seeds, trace_rig, asked.workers)
    print(report(read(asked.output)))


def arguments(doc: str, kinds: Sequence[str], count: int) -> argparse.Namespace:
    """Read the command line, with the kinds there are and how many of each by default."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True, help='JSON lines file')
    parser.add_argument('--seeds', choices=FIRST_SEED, default='development',
                        help='nobody tunes on the held-out ones')
    parser.add_argument('--kinds', nargs='+', choices=kinds, default=kinds)
    parser.add_argument('--count', type=int, default=count, help='rigs of each kind')
    parser.add_argument('--seed', type=int, nargs='+', help='these seeds only')
    parser.add_argument('--workers', type=int, default=2)
    return parser.parse_args()


def seeds_of(asked: argparse.Namespace, kinds: Sequence[str]) -> list[int]:
    """List the seeds asked for, where each kind has its block of them."""
    named: list[int] = asked.seed or [FIRST_SEED[asked.seeds] + BLOCK * kinds.index(kind) + k
                                      for kind in asked.kinds for k in range(asked.count)]
    return named


def complete(output: Path, seeds: Sequence[int], trace_one: TraceOne, workers: int) -> None:
    """Trace the seeds that a file of results lacks, and add them to it."""
    output.parent.mkdir(parents=True, exist_ok=True)
    known = read(output)
    there = {line['seed'] for line in known}
    missing = [seed for seed in seeds if seed not in there]
    with output.open('w') as file:    # anew: an interrupt may have cut its last line
        file.writelines(json.dumps(line) + '\n' for line in known)
        for line in traced(missing, trace_one, workers):
            file.write(json.dumps(line) + '\n')
            file.flush()


def traced(seeds: Sequence[int], trace_one: TraceOne, workers: int) -> Iterator[dict[str, Any]]:
    """Trace the rigs in that many processes, in whatever order they finish."""
    os.environ.update(ENVIRONMENT)
    with ProcessPoolExecutor(workers, get_context('spawn')) as pool, \
            Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task('tracing', total=len(seeds))
        try:
            for done in as_completed([pool.submit(trace_one, seed) for seed in seeds]):
                progress.advance(task)
                yield done.result()
        finally:    # an interrupt must not wait for all the others
            pool.shutdown(cancel_futures=True)


def add_trace(line: dict[str, Any], recording: Recording, plant: Plant) -> None:
    """Add to a line what the tracer says ('report' or 'failure') and how long it takes."""
    from hydro_twin.inference.trace import trace
    from hydro_twin.report.summary import summarise

    begin = time.perf_counter()
    try:
        summary = summarise(trace(recording, None, plant))
        line['report'] = {name: part for name, part in summary.items() if name != 'series'}
    except Exception:    # a rig that breaks the tracer is a result, and the others go on
        line['failure'] = traceback.format_exc()
    line['seconds'] = time.perf_counter() - begin


def trace_rig(seed: int) -> dict[str, Any]:
    """Return the truth, what the tracer said ('report' or 'failure') and how long it took."""
    from hydro_twin.plants.load_simulator import LOAD_SIMULATOR

    case = case_of(seed)
    rig = case.rig()
    alone = {}
    if case.kind in SEVERAL:
        alone = {one: shows(case.rig(left_out=tuple(set(case.effects) - {one})))
                 for one in case.effects}
    line: dict[str, Any] = {
        'seed': case.seed, 'kind': case.kind, 'effects': case.effects, 'snr_db': case.snr_db,
        'excitation': case.excitation, 'truth': rig.truth.summary(), 'shows': shows(rig),
        'shows_alone': alone, 'shows_beside': {}, 'true_error': None,
    }
    if case.kind in ('none', 'single', *SEVERAL):   # the library describes these
        best = true_fit(rig)
        line['true_error'] = error_on_test(best, rig)
        if case.kind in SEVERAL:
            line['shows_beside'] = shows_beside(best, rig)
    add_trace(line, rig.recording(), LOAD_SIMULATOR)
    return line


if __name__ == '__main__':
    main()
