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
    progress,
    rig_from,
    train_and_test,
)
from hydro_twin.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

    from hydro_twin.fitting.refit import Errors
    from hydro_twin.predictors.network import Network

EPOCHS = 500                                # of [B19]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bag_arguments(parser)
    add_rig_arguments(parser)
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='MODEL',
                        help='the model file to write; network weights go beside it')
    parser.add_argument('--predictor', choices=('analytical', 'mlp', 'hybrid'),
                        default='analytical', help='what to fit (default: %(default)s)')
    parser.add_argument('--method', default='least_squares',
                        choices=('least_squares', 'random', 'ea', 'pso', 'bees', 'network'),
                        help='for the physical parameters (default: %(default)s); network is '
                        'that of [L18] for the valve servo')
    parser.add_argument('--criterion', choices=('one_step', 'free_run'),
                        help='the error to minimise (default: free_run for least_squares, '
                        'one_step for the others)')
    add_seed_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Fit a model and write it.

    Returns:
        The model's path, its parameters, its errors on both parts, and between which errors
        any one-step fit must lie, all in the output's unit.
    """
    from hydro_twin.commands.provenance import provenance
    from hydro_twin.fitting.refit import (
        bounds_of,
        errors_of,
        fit_network,
        fit_physics,
        with_errors,
    )
    from hydro_twin.model import Model, write_model
    from hydro_twin.predictors.analytical import Analytical

    if not args.output.absolute().parent.is_dir():
        raise UserError(f'{args.output}: there is no folder {args.output.parent}')
    rig = rig_from(args)
    plant = rig.plant
    criterion = args.criterion or (
        'free_run' if args.method == 'least_squares' else 'one_step')
    train, test = train_and_test(args, rig)
    bounds = bounds_of(train, test, plant)
    model = Model(
        plant, {}, rig.constants, plant.sample_time, args.predictor,
        provenance=provenance(train.sources, test.sources if args.test else (), args.seed)
        | {'method': args.method, 'criterion': criterion})
    known = None
    if args.predictor != 'mlp':
        with progress('fitting the physics'):
            physics = fit_physics(train, plant, rig.constants, args.method, criterion, args.seed)
        model, known = replace(model, parameters=physics.estimates), physics.known
    if args.predictor == 'analytical':
        errors = errors_of(Analytical(model), train, test)
    else:
        from hydro_twin.predictors.hybrid import NetworkPredictor

        with progress('training the network', EPOCHS) as tick:
            network = fit_network(train, model, args.seed, tick)
        weights = args.output.with_suffix('.safetensors')
        model = replace(model, network=weights.name)
        errors = errors_of(NetworkPredictor(model, network), train, test)
        _save(network, weights)
    write_model(with_errors(model, errors), args.output)

    units = {p.name: p.unit for p in plant.parameters}
    return {
        'model': str(args.output),
        'unit': plant.output.unit,
        'parameters': {name: {'value': e.value, 'unit': units[name], 'std_error': e.std_error,
                              'identifiable': e.identifiable}
                       for name, e in model.parameters.items()},
        'at_bound': list(known.at_bound) if known else [],
        'combinations': dict(known.combinations) if known else {},
        'train': _part(errors, 'train'),
        'test': _part(errors, 'test'),
        **bounds,
    }


def _save(network: Network, path: Path) -> None:
    """Write the weights beside the model."""
    from hydro_twin.predictors.network import save_network

    save_network(network, path)


def _part(errors: Errors, name: str) -> dict[str, float]:
    """Take the errors of one part."""
    return {mode: parts[name] for mode, parts in errors.items()}


def show(result: dict[str, Any], console: Console) -> None:
    """Print parameters and errors."""
    from rich.table import Table

    if result['parameters']:
        table = Table('parameter', 'value', 'standard error', 'unit')
        for name, p in result['parameters'].items():
            error = f'{p["std_error"]:.2g}' if p['std_error'] is not None else (
                'at its bound' if name in result['at_bound'] else
                'not identifiable' if not p['identifiable'] else 'unknown')
            table.add_row(name, f'{p["value"]:.5g}', error, p['unit'])
        console.print(table)
    for name, error in result['combinations'].items():
        if error is not None:
            console.print(f'{name} is known to {100 * error:.2g} %, its members are not',
                          highlight=False)
    table = Table(f'RMS error [{result["unit"]}]', 'train', 'test')
    for mode in ('one_step', 'free_run'):
        table.add_row(mode.replace('_', ' '),
                      *(f'{result[part][mode]:.4g}' for part in ('train', 'test')))
    for bound, says in (('unconstrained', 'one step, no physics'),
                        ('persistence', 'one step, last sample')):
        table.add_row(says, *(f'{result[bound][part]:.4g}' for part in ('train', 'test')))
    console.print(table)
    console.print(f'model written to {result["model"]}')
