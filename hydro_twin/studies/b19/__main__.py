"""Remake the results, tables and figures of docs/load_simulator.md."""
from __future__ import annotations

import argparse
import json
from pathlib import Path

from hydro_twin.progress import progress
from hydro_twin.studies.b19.page import write_page
from hydro_twin.studies.b19.reproduce import Job, run_step, RUNS, STEPS


def main() -> None:
    """Run all steps, and write what they found."""
    parser = argparse.ArgumentParser(prog='python -m hydro_twin.studies.b19', description=__doc__)
    parser.add_argument('-o', '--output', type=Path, default=Path('docs'), metavar='DIR',
                        help='where load_simulator.md lies (default: docs)')
    parser.add_argument('--work', type=Path, default=Path('out/b19'), metavar='DIR',
                        help='what each step found; an interrupted run goes on from there '
                        '(default: %(default)s)')
    parser.add_argument('--leg', type=Path, metavar='DIR',
                        help='measured recordings of the leg, see docs/measured.md; without them '
                        'the stored results on it stay')
    parser.add_argument('--runs', type=int, default=RUNS, help='runs of each method')
    parser.add_argument('--device', default='cpu', help='cpu or cuda')
    args = parser.parse_args()
    job = Job(args.work, args.runs, args.device, args.leg)
    stored = args.output / 'load_simulator.json'
    results = {}
    with progress('reproducing', len(STEPS)) as done:
        for name in STEPS:
            results[name] = run_step(name, job)
            done()
    if results['measured'] is None and stored.exists():
        results['measured'] = json.loads(stored.read_text(encoding='utf-8'))['measured']
    write_page(results, args.output)


if __name__ == '__main__':
    main()
