"""Identify a valve servo both ways, as published and by least squares, and show them together.

Run it as `python -m hydro_twin.valve.identify BAG -o DIR`.
"""
from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
import json
import math
from pathlib import Path
import sys
from typing import Any

from hydro_twin.commands.common import (
    add_config_argument,
    add_seed_argument,
    progress,
    read,
    rig_of,
)
from hydro_twin.commands.main import plain
from hydro_twin.errors import UserError
from hydro_twin.model import Estimate
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.valve.direct import fit_free_run, fit_one_step, NAMES
from hydro_twin.valve.figures import draw_residual, residual_figures
from hydro_twin.valve.files import write_whole
from hydro_twin.valve.linear_loop import LoopParameters, PUBLISHED
from hydro_twin.valve.published_method import fit_published, PublishedFit


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the identification; 2 after an error of the user's."""
    parser = argparse.ArgumentParser(
        prog='python -m hydro_twin.valve.identify',
        description='Identifies the linear valve servo by least squares and by the published '
                    'network method, and shows both beside the figures of [L18].')
    parser.add_argument('bag', type=Path, metavar='BAG',
                        help='recording of command and opening, away from the limits')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='DIR',
                        help='where identification.json and four figures go')
    parser.add_argument('--k-1', type=float, default=PUBLISHED.k_1, metavar='K',
                        help='correction coefficient, which the recording cannot tell '
                             '(default: as published, %(default)s)')
    add_config_argument(parser)
    add_seed_argument(parser)
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    args = parser.parse_args(arguments)
    try:
        if not 0 < args.k_1 < math.inf:
            raise UserError(f'--k-1 {args.k_1:g}: must be above zero')
        recording = read([args.bag], rig_of(VALVE_SERVO, args.config))
        with progress('fitting', 3) as done:
            free_run = fit_free_run(recording, args.k_1)
            done()
            one_step = fit_one_step(recording, args.k_1)
            done()
            published = fit_published(recording, args.k_1, args.seed)
            done()
        result = {'bag': args.bag, **report(free_run, one_step, published, args.k_1)}
        args.output.mkdir(parents=True, exist_ok=True)
        draw_residual(published, args.output)
        write_whole(args.output / 'identification.json',
                    json.dumps(plain(result), indent=2, allow_nan=False).encode())
    except (UserError, OSError) as error:
        print(f'{parser.prog}: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    if args.json:
        print(json.dumps(plain(result), allow_nan=False))
    else:
        show(result)
    return 0


def report(free_run: Mapping[str, Estimate], one_step: Mapping[str, Estimate],
           published: PublishedFit, k_1: float) -> dict[str, Any]:
    """Gather all fits, and the paper's figures, for JSON."""
    def estimates(fit: Mapping[str, Estimate]) -> dict[str, Any]:
        return {name: {'value': e.value, 'unit': 's', 'std_error': e.std_error,
                       'identifiable': e.identifiable} for name, e in fit.items()}

    def reading(parameters: LoopParameters | str) -> dict[str, Any]:
        if isinstance(parameters, str):
            return {'parameters': None, 'reason': parameters}
        return {'parameters': parameters._asdict()}

    return {
        'k_1': k_1,
        'paper': PUBLISHED._asdict(),
        'least_squares': {'free_run': estimates(free_run), 'one_step': estimates(one_step)},
        'network': {
            'weights': {'v': published.weights.v, 'n': published.weights.n},
            'exact': reading(published.exact), 'printed': reading(published.printed),
            'errors': published.errors(), 'correlation': residual_figures(published)},
    }


def show(result: Mapping[str, Any]) -> None:
    """Print the parameters side by side, then the errors of the networks."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    network = result['network']
    table = Table('[s]', 'paper', 'free run', 'one step', 'network, poles', 'network, eq. 3',
                  title=f'Valve servo, k_1 = {result["k_1"]:g} taken as given')
    for name in NAMES:
        direct = [result['least_squares'][how][name] for how in ('free_run', 'one_step')]
        shown = [f'{fit["value"]:.5f} ± {fit["std_error"]:.5f}' if fit['identifiable']
                 else 'not identifiable' for fit in direct]
        read = [f'{parameters[name]:.5f}' if parameters else 'none'
                for parameters in (network[how]['parameters'] for how in ('exact', 'printed'))]
        table.add_row(name, f'{result["paper"][name]:.5f}', *shown, *read)
    console.print(table)
    for how in ('exact', 'printed'):
        if 'reason' in network[how]:
            console.print(f'network: {network[how]["reason"]}', highlight=False)
    errors = Table('RMS [1]', 'train', 'test', title='Networks on the filtered window')
    for name, parts in network['errors'].items():
        errors.add_row(name, *(f'{parts[part]:.2e}' for part in ('train', 'test')))
    console.print(errors)


if __name__ == '__main__':
    sys.exit(main())
