"""hydro-twin trace: finds the effect that a model lacks, adds it, and shows the gain."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import (
    add_bag_arguments,
    add_rig_arguments,
    add_seed_argument,
    progress,
    read_apart,
    rig_from,
)
from hydro_twin.errors import UserError

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
                        help='a model to start from, instead of a fresh fit')
    add_seed_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Trace, and write the report and the model.

    Returns:
        The report object.
    """
    from hydro_twin.commands.provenance import provenance
    from hydro_twin.model import read_model
    from hydro_twin.report.trace_files import write_files
    from hydro_twin.residual.trace import trace

    model = read_model(args.model) if args.model else None
    rig = rig_from(args, model)
    if model is not None and model.kind != 'analytical':
        raise UserError(f'{args.model}: a model of kind {model.kind}; a trace starts from an '
                        'analytical one')
    if args.output.exists() and not args.output.is_dir():
        raise UserError(f'{args.output}: is a file; a folder is needed for the report')
    recording, *tests = read_apart([args.bags, args.test] if args.test else [args.bags], rig)
    test = tests[0] if tests else None
    if model is not None:
        model = model.at(recording.sample_time)
    with progress('tracing') as step:
        result = trace(recording, test, rig.plant, rig.constants, model, args.seed,
                      lambda _: step())
    origin = provenance(recording.sources, test.sources if test else (), args.seed)
    return write_files(result, args.output, origin)


def show(result: dict[str, Any], console: Console) -> None:
    """Print the verdict, the effects, and the errors before and after."""
    from rich.table import Table

    console.print(result['says'], style='bold')
    for effect in result['effects']:
        values = ', '.join(
            f'{name} {p["value"]:.4g} {p["unit"]}'
            + (f' ± {p["std_error"]:.2g}' if p['std_error'] is not None else '')
            for name, p in effect['parameters'].items())
        console.print(f'{effect["id"]} at {effect["port"]}: {values} '
                      f'({"certain" if effect["certain"] else "not certain"})')
    table = Table('error (RMS)', 'before', 'after')
    for kind in ('free_run', 'one_step'):
        for part in ('train', 'test'):
            table.add_row(f'{kind.replace("_", " ")}, {part}',
                          *(f'{result[when][kind][part]:.4g}' for when in ('before', 'after')))
    table.add_row('repeating the last sample, test', f'{result["persistence"]["test"]:.4g}', '')
    table.add_row('noise, estimated', f'{result["noise_floor"]:.4g}', '')
    console.print(table)
    console.print(f'What remains: {result["remainder"]["says"]}.')
