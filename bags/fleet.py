"""Simulates a year of ten governor valves and writes their manifest, for `make fleet-demo`.

    python bags/fleet.py out/fleet

The valves are of one type: their time constants and their play scatter by a few per cent. The play
of one grows over the year, and one is recorded for a shorter time than the others.
"""
from __future__ import annotations

import argparse
import contextlib
import csv
import io
from pathlib import Path
import sys

import numpy as np

from hydro_twin.commands.main import main as hydro_twin

DATES = ('2025-01-15', '2025-04-15', '2025-07-15', '2025-10-15')
VALVES = 10
USUAL = {'T_y': 0.0203, 'T_c': 0.294, 'tau': 0.00293, 'k_1': 1.0}       # [L18]
PLAY = 0.004            # of full opening, across
SCATTER = 0.05          # of each between valves (standard deviation of the logarithm)
GROWS, GROWTH = 7, 1.5  # this valve's play, by so much each quarter
SHORT = 4               # this one is recorded for half the time
DURATION = 2.0          # [s]
NOISE = 5e-4            # RMS, of full opening


def main() -> int:
    """Simulate what is not there yet; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('folder', type=Path, help='for the bags and fleet.csv')
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    rows = []
    for valve in range(1, VALVES + 1):
        own = {name: value * np.exp(SCATTER * rng.normal()) for name, value in USUAL.items()}
        play = PLAY * np.exp(SCATTER * rng.normal())
        for quarter, date in enumerate(DATES):
            bag = folder / f'valve_{valve}_{date}'
            gap = play * (GROWTH ** quarter if valve == GROWS else 1.0)
            if not bag.exists():
                simulate(bag, own, gap, DURATION / 2.0 if valve == SHORT else DURATION,
                         10 * valve + quarter)
            rows.append([f'valve {valve}', 'valve_servo', bag.name, date, 'DN 200',
                         'north' if valve <= VALVES // 2 else 'south'])
    with (folder / 'fleet.csv').open('w', encoding='utf-8', newline='') as stream:
        writer = csv.writer(stream)
        writer.writerow(['name', 'plant', 'bags', 'date', 'group', 'site'])
        writer.writerows(rows)
    return 0


def simulate(bag: Path, values: dict[str, float], gap: float, duration: float, seed: int) -> None:
    """Make a bag of steps as the valve would have moved."""
    words = ['simulate', '--plant', 'valve_servo', '--duration', str(duration), '--noise',
             str(NOISE), '--excitation', 'command=steps', '--seed', str(seed), '--effect',
             f'backlash@linkage:gap={gap}', '-o', str(bag)]
    for name, value in values.items():
        words += ['--set', f'{name}={value}']
    with contextlib.redirect_stdout(io.StringIO()):
        if hydro_twin(words):
            sys.exit(f'{bag}: not simulated')


if __name__ == '__main__':
    sys.exit(main())
