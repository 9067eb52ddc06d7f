"""hydro-twin trace: finds the effect that a model lacks, adds it, and shows the gain."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import (
    add_bag_arguments,
    add_rig_arguments,
    add_seed_argument,
    command_line,
    data_from,
    rig_from,
)
from hydro_twin.commands.verb import Verb
from hydro_twin.errors import UserError
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bag_arguments(parser)
    add_rig_arguments(parser)
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='DIR',
                        help='folder for report.html, report.json, model.yaml, before.yaml, '
                             'series.csv and figures/')
    parser.add_argument('--model', type=Path, metavar='MODEL',
                        help='a model to start from, instead of a new fit')
    parser.add_argument('--earlier', action='append', default=[], type=Path, metavar='BAG',
                        help='with --model: a recording that this model was made from; parameters '
                        'that have not changed since are estimated from old and new '
                        'recordings together; may be repeated')
    add_seed_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Trace, and write the report and the model.

    Returns:
        The report object.
    """
    from hydro_twin.parallel import prepare

    # As `api.trace` does, but before this process takes a second to import the same.
    prepare('hydro_twin.inference.trace', 'hydro_twin.report.drawing')

    from hydro_twin import api
    from hydro_twin.model import read_model

    model = read_model(args.model) if args.model else None
    rig = rig_from(args, model)
    if args.earlier and model is None:
        raise UserError('--earlier is for the recordings that a --model came from')
    if model is not None:
        api.check_analytical(model, args.model)
    if args.output.exists() and not args.output.is_dir():
        raise UserError(f'{args.output}: is a file; a folder is needed for the report')
    found = api.trace(data_from(args, rig, args.earlier), model, args.seed,
                      command=command_line(args), show=progress)
    return found.save(args.output)


def show(result: dict[str, Any], console: Console) -> None:
    """Print the verdict, the effects, and the errors before and after."""
    from rich.table import Table

    from hydro_twin.predictors.scores import FIGURES

    console.print(result['says'], style='bold')
    for effect in result['effects']:
        values = ', '.join(
            f'{name} {p["value"]:.4g} {p["unit"]}'
            + (f' ± {p["std_error"]:.2g}' if p['std_error'] is not None else '')
            + ''.join(f' at {held} = {value:.4g}'
                      for held, value in effect['given'].get(name, {}).items())
            for name, p in effect['parameters'].items())
        sure = 'certain' if effect['certain'] else f'probability {effect["probability"]:.2f}'
        console.print(f'{effect["id"]} at {effect["port"]}: {values} ({sure})')
    table = Table('error (RMS)', 'before', 'after')
    for kind in FIGURES:
        if any(kind not in result[when] for when in ('before', 'after')):
            continue
        for part in ('train', 'test'):
            table.add_row(f'{kind.replace("_", " ")}, {part}',
                          *(f'{result[when][kind][part]:.4g}' for when in ('before', 'after')))
    table.add_row('repeating the last sample, test', f'{result["persistence"]["test"]:.4g}', '')
    table.add_row('noise, estimated', f'{result["noise_floor"]:.4g}', '')
    console.print(table)
    if result['memory']:
        console.print(f'Earlier recordings: {result["memory"]["says"]}.')
    console.print(f'What remains: {result["remainder"]["says"]}.')


VERB = Verb('trace', 'find the physical effect that a model lacks, add it, show the gain',
            add_arguments, run, show)
