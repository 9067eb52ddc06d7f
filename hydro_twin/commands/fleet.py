"""hydro-twin fleet: traces every rig of a manifest, compares them, and makes one page of all."""
from __future__ import annotations

import argparse
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import add_seed_argument
from hydro_twin.commands.verb import Verb
from hydro_twin.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('manifest', type=Path, metavar='MANIFEST',
                        help='CSV or YAML file with the rigs and their bags (docs/fleet.md)')
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='DIR',
                        help='folder for fleet.html, fleet.json, fleet.parquet and results/, '
                        'the reports; what is there already is not traced again')
    parser.add_argument('--workers', type=count, metavar='N',
                        help='processes of one core each (default: as many as there are cores)')
    parser.add_argument('--scheduler', default='', metavar='ADDRESS',
                        help='a Dask scheduler, as tcp://10.0.0.1:8786, instead of processes of '
                        'this machine')
    add_seed_argument(parser)


def count(text: str) -> int:
    """Read a number of processes.

    Raises:
        argparse.ArgumentTypeError: it is no whole number, or below one.
    """
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f'{text!r} should be a whole number, 1 or above')
    return int(text)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Trace the fleet, and write tables and page; returns what fleet.json holds."""
    from hydro_twin.fleet import trace_fleet
    from hydro_twin.fleet.manifest import ManifestError

    if args.workers and args.scheduler:
        raise UserError('--workers is for a cluster of this machine, not for that of --scheduler')
    try:
        fleet = trace_fleet(args.manifest, args.output, scheduler=args.scheduler,
                            workers=args.workers, seed=args.seed, say=say)
    except ManifestError as error:
        *first, last = str(error).splitlines()
        for fault in first:
            say(fault)
        raise UserError(last) from None
    return {**fleet, 'page': str(args.output / 'fleet.html')}


def say(line: str) -> None:
    """Print a line on standard error."""
    print(f'hydro-twin fleet: {line}', file=sys.stderr, flush=True)


def show(result: dict[str, Any], console: Console) -> None:
    """Print the rigs that stand out most, and where the page is."""
    from rich.table import Table

    table = Table('rig', 'group', 'verdict', 'effect', 'score', 'of')
    for rig in result['rigs'][:10]:
        score = rig['score']
        table.add_row(rig['rig'], rig['group'], rig['verdict'].replace('_', ' '),
                      ', '.join(rig['effects']), f'{score["value"]:.1f}' if score else '',
                      score['name'] if score else '')
    console.print(table)
    traces = result['traces']
    console.print(f'{len(result["rigs"])} rigs, {traces["done"]} traces '
                  f'({traces["traced_now"]} of them now), {traces["failed"]} failed: '
                  f'see {result["page"]}')


VERB = Verb('fleet', 'trace many rigs, compare them, make one page of all', add_arguments, run,
            show)
