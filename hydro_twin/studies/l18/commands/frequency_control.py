"""hydro-twin frequency-control: a linear and a nonlinear valve servo in primary control."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.verb import Verb

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('bag', nargs='?', type=Path, metavar='BAG',
                        help='recording of frequency, opening and power; without it the frequency '
                             'falls by 0.2 Hz')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='DIR',
                        help='where comparison.json and comparison.png go')
    parser.add_argument('--model', type=Path, metavar='M',
                        help='model file of the servo (default: as published in [L18])')
    parser.add_argument('--curve', type=Path, metavar='CSV',
                        help='flow characteristic: columns opening, flow, of nominal or in per '
                        'cent (default: a typical one)')
    parser.add_argument('--config', type=Path, metavar='FILE',
                        help='signals and constants (default: config/frequency_control.yaml)')
    parser.add_argument('--load', type=float, metavar='SHARE',
                        help='power at rest at nominal frequency, as a share of nominal power '
                             '(default: that of BAG, else 0.89)')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate the event with both servos; returns what comparison.json holds."""
    from hydro_twin.studies.l18.frequency_control import compare

    return compare(args.bag, args.output, args.model, args.curve, args.config, args.load)


def show(result: dict[str, Any], console: Console) -> None:
    """Print fit degree and steady errors of each servo."""
    from rich.table import Table

    table = Table('servo', 'signal', 'fit degree [%]', 'steady error [% of nominal]',
                  'relative error [%]',
                  title=f'Load {result["load"]:.3g}, d_1 = {result["d_1"]:g}; '
                        f'against the {result["against"]}')
    for servo, signals in result['agreement'].items():
        for signal, figures in signals.items():
            table.add_row(servo, signal, *(f'{value:.3f}' for value in figures.values()))
    console.print(table)


VERB = Verb('frequency-control',
            'simulate primary frequency control with a linear '
            'and a nonlinear valve servo',
            add_arguments, run, show)
