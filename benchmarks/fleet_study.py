"""How many rigs with an effect a fleet finds, and what it says of those without.

    uv run --group dev python -m benchmarks.fleet_study out/study [--rigs 200]

Process valves of three types, one in ten with an effect, recorded once each and traced by the
verb `fleet`. A run that was stopped resumes where it was. What single traces find is beside what
the fleet shows: it marks the rigs that are not as the others of their type, too.
"""
from __future__ import annotations

import argparse
import contextlib
import io
import json
from pathlib import Path
import sys
from typing import Any

import numpy as np

from hydro_twin.commands.main import main as hydro_twin

PLANT = 'control_valve'
TYPES = {'small': {'tau': 1.5, 'K': 1.0}, 'medium': {'tau': 4.0, 'K': 0.9},
         'large': {'tau': 10.0, 'K': 1.1}}
SCATTER = 0.05          # of each parameter between the rigs of a type (of its logarithm)
EFFECTS = ('backlash@stem:gap=0.03', 'saturation@stem:lower=-10,upper=0.6', 'delay@command:time=3')
EVERY = 10              # rig has an effect
NOISE = 5e-3            # RMS, of full opening
DURATION = 200          # [s], and samples


def main() -> int:
    """Simulate and trace what is not done yet, and print what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('folder', type=Path, help='for the bags and results')
    parser.add_argument('--rigs', type=int, default=200)
    parser.add_argument('--workers', default='2')
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    truth = recorded(args.folder, args.rigs)
    if hydro_twin(['fleet', str(args.folder / 'fleet.csv'), '-o', str(args.folder / 'out'),
                   '--workers', args.workers]):
        return 1
    fleet = json.loads((args.folder / 'out' / 'fleet.json').read_text(encoding='utf-8'))
    report(fleet['rigs'], truth)
    return 0


def recorded(folder: Path, count: int) -> dict[str, str]:
    """Simulate a bag of each rig; returns the effect of each, '' for none."""
    truth, rows = {}, ['name,plant,bags,group']
    for k in range(count):
        kind, name = list(TYPES)[k % len(TYPES)], f'rig {k}'
        effect = EFFECTS[k // EVERY % len(EFFECTS)] if k % EVERY == EVERY - 1 else ''
        truth[name] = effect.partition('@')[0]
        rows.append(f'{name},{PLANT},bag_{k},{kind}')
        if not (folder / f'bag_{k}').exists():
            rng = np.random.default_rng(k)
            own = {one: value * np.exp(SCATTER * rng.normal())
                   for one, value in TYPES[kind].items()}
            words = ['simulate', '--plant', PLANT, '--noise', str(NOISE), '--duration',
                     str(DURATION), '--excitation', 'command=steps', '--seed', str(k),
                     '-o', str(folder / f'bag_{k}'),
                     *(word for one, value in own.items() for word in ('--set', f'{one}={value}')),
                     *(('--effect', effect) if effect else ())]
            with contextlib.redirect_stdout(io.StringIO()):
                if hydro_twin(words):
                    sys.exit(f'bag_{k}: not simulated')
    (folder / 'fleet.csv').write_text('\n'.join(rows), encoding='utf-8')
    return truth


def report(rigs: list[dict[str, Any]], truth: dict[str, str]) -> None:
    """Print the counts."""
    having = [rig for rig in rigs if truth[rig['rig']]]
    without = [rig for rig in rigs if not truth[rig['rig']]]
    right = [rig for rig in having
             if any(one.startswith(f'{truth[rig["rig"]]} at ') for one in rig['effects'])]
    print(f'{len(having)} rigs with an effect: {sum(bool(rig["effects"]) for rig in having)} have '
          f'one by their trace, {len(right)} the right one')
    print(f'by trace or by standing out: {sum(shown(rig) for rig in having)}')
    print(f'{len(without)} without: {sum(bool(rig["effects"]) for rig in without)} have one by '
          f'their trace, {sum(stands_out(rig) for rig in without)} stand out')
    for rig in having:
        if rig not in right:
            print(f'{rig["rig"]} ({rig["group"]}, {truth[rig["rig"]]}): {rig["says"]}')


def stands_out(rig: dict[str, Any]) -> bool:
    """Whether the page marks a rig."""
    return bool(rig['score'] and rig['score']['out'])


def shown(rig: dict[str, Any]) -> bool:
    """Whether a rig is found either way."""
    return bool(rig['effects']) or stands_out(rig)


if __name__ == '__main__':
    sys.exit(main())
