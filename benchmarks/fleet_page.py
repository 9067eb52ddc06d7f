"""How long the page of a thousand rigs takes to open in a browser.

    uv run --group dev python -m benchmarks.fleet_page [--rigs 1000] [--keep PAGE]

The fleet is made up: six parameters, five periods, three types, rigs with one effect or none.
Times are those of headless Chromium, which must be installed, from the start of the navigation:
until the rows are there (DOMContentLoaded), and until the second frame after the page has loaded,
when it is painted. Beside them is the processor time that the browser took in all, less that for
an empty page, since the clock says little where a machine is busy.
"""
from __future__ import annotations

import argparse
import contextlib
import os
from pathlib import Path
from statistics import median
import sys
import tempfile
from typing import Any

import numpy as np

from benchmarks.browser import Browser
from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.page import page
from hydro_twin.fleet.summary import summarise
from hydro_twin.fleet.task import Outcome

RUNS = 3
DATES = ('2025-01-01', '2025-04-01', '2025-07-01', '2025-10-01', '2026-01-01')
NAMES = ('T_y', 'tau', 'T_c / k_1', 'k', 'd', 'backlash at linkage: gap')
HARNESS = """<script>
addEventListener('load', () => requestAnimationFrame(() => requestAnimationFrame(() => {
  const {domContentLoadedEventEnd} = performance.getEntriesByType('navigation')[0];
  report({rows: domContentLoadedEventEnd, painted: performance.now()});
})));
</script>"""


def main() -> int:
    """Make the page, open it, and print the medians."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--rigs', type=int, default=1000)
    parser.add_argument('--keep', type=Path, help='write the page there, too')
    args = parser.parse_args()
    text = page(made_up(args.rigs))
    if args.keep:
        args.keep.write_text(text, encoding='utf-8')
    empty = '<!doctype html><html><head></head><body></body></html>'
    with tempfile.TemporaryDirectory() as folder:
        opened(empty, Path(folder))
        times = [(opened(text, Path(folder)), opened(empty, Path(folder))) for _ in range(RUNS)]
    print(f'{args.rigs} rigs, {len(text) / 1e6:.1f} MB: '
          f'rows after {median(one["rows"] for one, _ in times):.0f} ms, painted after '
          f'{median(one["painted"] for one, _ in times):.0f} ms; processor '
          f'{median(one["processor"] - other["processor"] for one, other in times):.2f} s more '
          f'than for an empty page')
    return 0


def made_up(rigs: int) -> dict[str, Any]:
    """Make the results of a fleet up."""
    rng = np.random.default_rng(0)
    done = []
    for k in range(rigs):
        own = np.exp(rng.normal(0.0, 0.05, len(NAMES)))
        names = NAMES[:-1] if k % 3 else NAMES
        effects = [] if k % 3 else [{'id': 'backlash', 'port': 'linkage', 'certain': True,
                                     'probability': 0.995, 'p_value': 0.0,
                                     'share_of_residual': 0.9}]
        for date in DATES:
            values = own * np.exp(rng.normal(0.0, 0.01, len(NAMES)))
            done.append((
                Task(f'rig {k}', 'valve_servo', (), date, False, None, (), f'type {k // 3 % 3}',
                     (('site', f'site {k % 7}'),)),
                Outcome({
                    'verdict': 'effect_found' if effects else 'nothing_missing',
                    'says': 'The model lacks backlash at the linkage.', 'noise': 1e-3,
                    'unit': '1', 'error': {'before': 2e-3, 'after': 1e-3}, 'effects': effects,
                    'nothing': 0.0 if effects else 0.97, 'law_unknown': 0.03,
                    'estimates': {name: {'value': value, 'std_error': 0.01 * value, 'unit': 's'}
                                  for name, value in zip(names, values, strict=False)},
                    'factor': {'names': list(names), 'values': values[:len(names)].tolist(),
                               'rows': np.diag(100.0 / values[:len(names)]).tolist(),
                               'step': [0.0] * len(names)}}, key=f'{k:032x}')))
    return summarise(done)


def opened(text: str, folder: Path) -> dict[str, float]:
    """Open a page; returns its times [ms], and the processor time of the browser [s]."""
    with Browser(text, HARNESS, folder) as browser:
        times: dict[str, float] = browser.reported()
        return times | {'processor': used(browser.pid)}


def used(session: int) -> float:
    """Sum the processor time of all processes of a session [s]."""
    ticks = 0
    for path in Path('/proc').glob('[0-9]*/stat'):
        with contextlib.suppress(OSError):      # it has ended
            fields = path.read_text(encoding='utf-8').rpartition(')')[2].split()
            if int(fields[3]) == session:
                ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf('SC_CLK_TCK')


if __name__ == '__main__':
    sys.exit(main())
