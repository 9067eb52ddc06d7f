"""hydro-twin regimes: two models on recordings, regime by regime."""
from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import add_bags, add_config_argument
from hydro_twin.commands.verb import Verb
from hydro_twin.errors import UserError
from hydro_twin.live.settings import TWIN_MODES
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bags(parser)
    parser.add_argument('--model', required=True, type=Path, metavar='MODEL',
                        help='the model that is used')
    parser.add_argument('--challenger', required=True, type=Path, metavar='MODEL',
                        help='the model that may take its place')
    parser.add_argument('--fitted', action='append', default=[], type=Path, metavar='BAG',
                        help='one of BAG... that the challenger was fitted to: it helps to define '
                        'the regimes, but does not count as evidence; may be repeated')
    parser.add_argument('--mode', default='free_run', choices=TWIN_MODES,
                        help='mode in which the models run (default: free_run)')
    add_config_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Compare the models.

    Returns:
        The edges of the regimes, how long the recordings were in each, and the evidence there.

    Raises:
        UserError: --fitted names another bag, or the models do not fit each other or the bags.
    """
    from hydro_twin.keep.recorded import compare
    from hydro_twin.live.models import Choice, load_twin
    from hydro_twin.recording.rig import read_apart, rig_of

    if other := [bag for bag in args.fitted if bag not in args.bags]:
        raise UserError(f'--fitted {other[0]}: not one of BAG...')
    champion, challenger = (load_twin(Choice('', path), args.mode)
                            for path in (args.model, args.challenger))
    rig = rig_of(champion.predictor.plant, args.config, model=champion.predictor.model)
    apart = [bag for bag in args.bags if bag not in args.fitted]
    fitted, earlier = read_apart([args.fitted, apart], rig, progress)
    with progress('comparing'):
        known, regimes = compare(champion, challenger, fitted, earlier)
    return {**asdict(known), 'regimes': regimes.record()}


def show(result: dict[str, Any], console: Console) -> None:
    """Print it."""
    judged = result['regimes']
    for name in {**result['seen'], **judged}:
        console.print(name, style='bold')
        if name in result['seen']:
            console.print(f'  seen before: recorded for {result["seen"][name]:.0f} s')
        one = judged.get(name, {})
        if one.get('seconds'):
            console.print(f'  {one["seconds"]:.0f} s compared: RMS {one["rms_older"]:.3g}, of the '
                          f'challenger {one["rms_newer"]:.3g}; evidence that it holds '
                          f'{one["holds"]:.3g}, that it is worse {one["worse"]:.3g}')
    if not judged:
        console.print('nothing was compared')


VERB = Verb('regimes', 'compare two models on recordings, regime by regime', add_arguments, run,
            show)
