"""The verb `compare`: predictors and methods side by side over repeated runs, as in [B19]."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands import common
from hydro_twin.commands.verb import Verb
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `compare`."""
    common.add_bag_arguments(parser)
    common.add_rig_arguments(parser)
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='DIR',
                        help='folder for comparison.html, .csv and .json')
    parser.add_argument('--runs', type=int, default=20, help='runs of each method (default: 20)')
    parser.add_argument('--device', default='cpu',
                        help='where networks are trained: cpu or cuda (default: cpu)')
    parser.add_argument('--search', action='store_true',
                        help='choose weight decay and structure of the networks first, on a third '
                        'of the training patterns, instead of those of [B19]; its state is '
                        'kept in DIR/*.search.jsonl, from which an interrupted search resumes')
    common.add_seed_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Run the study as recorded, then with training and test data swapped."""
    from hydro_twin.errors import UserError
    from hydro_twin.fitting.network import check_device, SETTINGS
    from hydro_twin.studies.b19.comparison import summary, write_comparison
    from hydro_twin.studies.b19.settings import chosen_settings
    from hydro_twin.studies.b19.study import study, TITLES

    if args.runs < 1:
        raise UserError(f'--runs {args.runs}: at least one run is needed')
    if args.output.exists() and not args.output.is_dir():
        raise UserError(f'{args.output}: is not a folder')
    rig = common.rig_from(args)
    train, test = common.data_from(args, rig).parts
    check_device(args.device)
    pairs = {'direct': (train, test), 'swapped': (test, train)}
    chosen = dict.fromkeys(pairs, SETTINGS)
    if args.search:
        args.output.mkdir(parents=True, exist_ok=True)
        with progress('searching the settings') as tick:
            chosen = {name: chosen_settings(
                pair[0], rig.plant, rig.constants, args.output / f'{name}.{{}}.search.jsonl',
                args.seed, args.device, tick) for name, pair in pairs.items()}
    with progress('comparing', len(pairs) * len(TITLES) * args.runs) as run_done:
        studies = {
            name: study(*pair, rig.plant, rig.constants, args.runs, args.seed, args.device,
                        run_done, chosen[name]) for name, pair in pairs.items()}
    result = {
        'plant': rig.plant.name,
        'unit': rig.plant.output.unit,
        'sample_time': train.sample_time,
        'bags': [str(bag) for bag in (*args.bags, *args.test)],
        'runs': args.runs,
        'seed': args.seed,
        'settings': {name: {kind: {'hidden': list(found[kind].hidden), 'decay': found[kind].decay}
                            for kind in ('mlp', 'hybrid')} for name, found in chosen.items()},
        'experiments': summary(studies),
    }
    files = write_comparison(result, args.output)
    return {**result, 'files': [str(file) for file in files]}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the medians, and where the rest is."""
    from rich.table import Table

    for name, experiment in result['experiments'].items():
        table = Table(title=f'{name}: median RMS of {result["runs"]} runs [{result["unit"]}]')
        table.add_column('method')
        for part in ('train', 'test'):
            for mode in ('one step', 'free run'):
                table.add_column(f'{part}, {mode}', justify='right')
        for found in experiment['methods'].values():
            medians = [found['five_numbers'][part][mode][2]
                       for part in ('train', 'test') for mode in ('one_step', 'free_run')]
            table.add_row(found['title'], *('diverged' if value is None else f'{value:.4g}'
                                            for value in medians))
        for key, title in (('persistence', 'last sample repeated'),
                           ('unconstrained', 'linear without constraint')):
            train, test = (f'{experiment[key][part]:.4g}' for part in ('train', 'test'))
            table.add_row(title, train, '', test, '')
        console.print(table)
    console.print(f'written: {", ".join(result["files"])}')


VERB = Verb('compare', 'compare predictors and methods over repeated runs',
            add_arguments, run, show)
