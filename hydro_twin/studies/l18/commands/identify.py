"""hydro-twin identify: a valve servo by least squares and as published in [L18], side by side."""
from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import add_config_argument, add_seed_argument
from hydro_twin.commands.verb import Verb
from hydro_twin.errors import UserError
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from rich.console import Console

K_1 = 1.093             # as published [L18, Table 2]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('bag', type=Path, metavar='BAG',
                        help='recording of command and opening, away from the limits')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='DIR',
                        help='where identification.json and the figures 8 to 11 go')
    parser.add_argument('--k-1', type=float, default=K_1, metavar='K',
                        help='correction coefficient, which the recording cannot tell '
                             '(default: as published, %(default)s)')
    add_config_argument(parser)
    add_seed_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Identify both ways; returns what identification.json holds."""
    from hydro_twin.plants.valve_servo import VALVE_SERVO
    from hydro_twin.recording.rig import read, rig_of
    from hydro_twin.studies.l18.identify import identify

    if not 0 < args.k_1 < math.inf:
        raise UserError(f'--k-1 {args.k_1:g}: must be above zero')
    recording = read([args.bag], rig_of(VALVE_SERVO, args.config), progress)
    with progress('fitting', 4) as done:
        return identify(args.bag, recording, args.k_1, args.seed, args.output, done)


def show(result: dict[str, Any], console: Console) -> None:
    """Print the parameters side by side, then the errors of the networks."""
    from rich.table import Table

    network = result['network']
    table = Table('[s]', 'paper', 'free run', 'one step', 'network, nearest', 'network, poles',
                  'network, eq. 3', title=f'Valve servo, k_1 = {result["k_1"]:g} taken as given')
    for name in ('T_y', 'T_c', 'tau'):
        direct = [result['least_squares'][how][name] for how in ('free_run', 'one_step')]
        shown = [f'{fit["value"]:.5f} ± {fit["std_error"]:.5f}' if fit['identifiable']
                 else 'not identifiable' for fit in direct]
        read_back = [f'{parameters[name]:.5f}' if parameters else 'none' for parameters in
                     (network[how]['parameters'] for how in ('nearest', 'exact', 'printed'))]
        table.add_row(name, f'{result["paper"][name]:.5f}', *shown, *read_back)
    console.print(table)
    for how in ('exact', 'printed'):
        if 'reason' in network[how]:
            console.print(f'network: {network[how]["reason"]}', highlight=False)
    if network['nearest']['at_edge']:
        console.print(f'nearest: {", ".join(network["nearest"]["at_edge"])} at the edge of the '
                      'search box', highlight=False)
    errors = Table('RMS [1]', 'train', 'test', title='Networks on the filtered window')
    for name, parts in network['errors'].items():
        errors.add_row(name, *(f'{parts[part]:.2e}' for part in ('train', 'test')))
    console.print(errors)


VERB = Verb('identify', 'identify a turbine valve servo as published, and by least squares',
            add_arguments, run, show)
