"""hydro-twin excitation: says whether a recording moves the plant enough for a trace."""
from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import add_bags, add_config_argument
from hydro_twin.commands.verb import Verb
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bags(parser)
    parser.add_argument('--model', required=True, type=Path, metavar='MODEL',
                        help='an analytical model of this rig, as from refit or trace')
    add_config_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Judge the bags.

    Returns:
        Whether they are enough, what each parameter would be known to, and what cannot show.

    Raises:
        UserError: the model has weights.
    """
    from hydro_twin import api
    from hydro_twin.model import read_model

    model = read_model(args.model)
    api.check_analytical(model, args.model)
    found = api.excitation(api.read(args.bags, model.plant, config=args.config, model=model,
                                    show=progress), model)
    return {'enough': found.enough, 'says': found.says, 'std_errors': dict(found.std_errors),
            'weak': [{**asdict(one), 'says': one.says} for one in found.weak],
            'cannot_show': [asdict(one) for one in found.undetectable], 'effects': found.tried}


def show(result: dict[str, Any], console: Console) -> None:
    """Print it."""
    console.print('enough for a trace' if result['enough'] else 'not enough for a trace',
                  style='bold')
    console.print(result['says'])
    for name, error in result['std_errors'].items():
        console.print(f'{name}: ' + ('not known' if error is None else f'± {error:.2%}'))
    for weak in result['weak']:
        console.print(weak['says'])
    for one in result['cannot_show']:
        console.print(f'{one["id"]} at {one["port"]} cannot show: {one["says"]}')


VERB = Verb('excitation', 'say whether a recording moves the plant enough for a trace',
            add_arguments, run, show)
