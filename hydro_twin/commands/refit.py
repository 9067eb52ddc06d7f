"""hydro-twin refit: fits a model to recorded bags."""
from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import (
    add_bag_arguments,
    add_rig_arguments,
    add_seed_argument,
    assignment,
    check_file,
    command_line,
    data_from,
    rig_from,
)
from hydro_twin.commands.effect_option import EffectOption, GROUP
from hydro_twin.commands.verb import Verb
from hydro_twin.plugins import plugins
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bag_arguments(parser)
    add_rig_arguments(parser)
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='MODEL',
                        help='the model file to write; network weights go into the same folder')
    parser.add_argument('--predictor', default='analytical', metavar='KIND',
                        help='what to fit: analytical, mlp, gru or hybrid; an unknown name '
                        'prints the list (default: %(default)s)')
    parser.add_argument('--method', default='least_squares', metavar='METHOD',
                        help='for the physical parameters: least_squares; random, ea, pso or '
                        'bees, of [B19]; network, of [L18] for the valve servo; an unknown '
                        'name prints the list (default: %(default)s)')
    parser.add_argument('--criterion', choices=('one_step', 'free_run'),
                        help='the error to minimise (default: free_run for an analytical '
                        'model by least_squares, else one_step)')
    parser.add_argument('--model', type=Path, metavar='MODEL',
                        help='an analytical model that is fitted anew, with its effects; for '
                        'a hybrid: the one that it is based on, as it is')
    parser.add_argument('--fix', action='append', default=[], type=assignment,
                        metavar='NAME=VALUE', help='hold a parameter at a known value, as '
                        'k_1=1.093, and fit the others; may be repeated')
    for option in plugins(GROUP, EffectOption):
        parser.add_argument(f'--{option.name}', type=Path, metavar=option.metavar,
                            help=option.help)
    networks = parser.add_argument_group('networks', 'the defaults are those of [B19]')
    networks.add_argument('--hidden', type=widths, metavar='WIDTHS',
                          help='widths of the hidden layers (default: 77,77; hybrid: 80; GRU, '
                          'which has one layer: 42)')
    networks.add_argument('--decay', type=decay,
                          help='weight decay, against the sum of squared scaled errors '
                          '(default: 5e-4; hybrid and GRU: 0)')
    networks.add_argument('--epochs', type=int, default=500,
                          help='training epochs (default: %(default)s)')
    networks.add_argument('--search', action='store_true',
                          help='search the weight decay and the structure, 1 or 2 layers of 1 to '
                          '100 units, on a third of the training patterns; a value given by '
                          '--hidden or --decay is kept. Its state is saved in '
                          'MODEL.search.jsonl, from which an interrupted search resumes')
    networks.add_argument('--device', default='cpu',
                          help='torch device, cpu or cuda (default: %(default)s)')
    add_seed_argument(parser)


def widths(text: str) -> tuple[int, ...]:
    """Read the widths of hidden layers.

    Raises:
        argparse.ArgumentTypeError: it is not of the form 77,77.
    """
    if not all(width.isdecimal() and int(width) > 0 for width in text.split(',')):
        raise argparse.ArgumentTypeError(f'{text!r} should read like 77,77')
    return tuple(int(width) for width in text.split(','))


def decay(text: str) -> float:
    """Read a weight decay.

    Raises:
        argparse.ArgumentTypeError: it is no finite number, or below zero.
    """
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float('inf'):
        raise argparse.ArgumentTypeError(f'{text!r} should be a number, 0 or above')
    return value


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Fit a model and write it.

    Returns:
        The model's path, its parameters, its errors on both parts, and the one-step errors that
        these are compared with, all in the output's unit.

    Raises:
        UserError: the model cannot be written there, or what is asked for does not go together.
    """
    from hydro_twin import api
    from hydro_twin.fitting.refit import check_name, companion, Request
    from hydro_twin.model import read_model

    check_file(args.output, 'model')
    check_name(args.output)
    request = Request(
        args.predictor, args.method, args.criterion, dict(args.fix), hidden=args.hidden,
        decay=args.decay, epochs=args.epochs, device=args.device, seed=args.seed,
        search=companion(args.output, '.search.jsonl') if args.search else None)
    given = {option: path for option in plugins(GROUP, EffectOption)
             if (path := getattr(args, option.name))}
    request.check(effects=bool(given), base=bool(args.model))
    if args.model:
        request = replace(request, base=read_model(args.model))
    rig = rig_from(args, request.base)
    rig.plant.holding(request.held)
    request = replace(request, effects=tuple(
        placed for option, path in given.items() for placed in option.effects(path, rig.plant)))
    fitted = api.refit(data_from(args, rig), request, command=command_line(args), show=progress)
    fitted.save(args.output)
    return {'model': str(args.output), **fitted.summary()}


def show(result: dict[str, Any], console: Console) -> None:
    """Print parameters and errors."""
    from rich.table import Table

    from hydro_twin.fitting.physics import BIASED
    from hydro_twin.predictors.scores import FIGURES

    if result['parameters']:
        table = Table('parameter', 'value', 'standard error', 'unit')
        for name, p in result['parameters'].items():
            error = f'{p["std_error"]:.2g}' if p['std_error'] is not None else (
                'held' if p['held'] else
                f'at its {p["at_bound"]} bound' if p['at_bound'] else
                'not identifiable' if not p['identifiable'] else
                'biased' if BIASED in result['notes'] else 'unknown')
            table.add_row(name, f'{p["value"]:.5g}', error, p['unit'])
        for effect in result['effects']:
            for name, p in effect['parameters'].items():
                error = 'held' if p['held'] else (
                    'not identifiable' if p['std_error'] is None else f'{p["std_error"]:.2g}')
                table.add_row(f'{effect["id"]}@{effect["port"]}: {name}', f'{p["value"]:.5g}',
                              error, p['unit'])
        console.print(table)
    for name, error in result['combinations'].items():
        if error is not None:
            console.print(f'{name} is known to {100 * error:.2g} %, its members are not',
                          highlight=False)
    for note in result['notes']:
        console.print(f'Note: {note}.', highlight=False)
    if result['hidden']:
        console.print(f'hidden layers: {", ".join(map(str, result["hidden"]))}; weight decay '
                      f'{result["decay"]:g}', highlight=False)
    table = Table(f'RMS error, {result["unit"]}', 'train', 'test')
    for mode in FIGURES:
        if mode not in result['train']:
            continue
        table.add_row(mode.replace('_', ' '),
                      *(f'{result[part][mode]:.4g}' for part in ('train', 'test')))
    for reference, says in (('unconstrained', 'one step, no physics'),
                            ('persistence', 'one step, last sample')):
        table.add_row(says, *(f'{result[reference][part]:.4g}' for part in ('train', 'test')))
    console.print(table)
    if len(result['outputs']) > 1:
        table = Table('free run', 'train', 'test', 'noise')
        for name, figures in result['outputs'].items():
            table.add_row(name, *(f'{figures[part]:.4g}' if part in figures else '–'
                                  for part in ('train', 'test', 'noise')))
        console.print(table)
    console.print(f'model written to {result["model"]}, sample time {result["sample_time"]:g} s')


VERB = Verb('refit', 'fit a model to recorded bags', add_arguments, run, show)
