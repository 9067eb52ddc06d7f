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
    progress,
    rig_from,
    train_and_test,
)
from hydro_twin.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

    from hydro_twin.fitting.identifiability import Identifiability
    from hydro_twin.fitting.refit import Errors, Physics
    from hydro_twin.model import Model
    from hydro_twin.predictors.network import Network
    from hydro_twin.recording.series import Recording


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
                        help='the error to minimise (default: free_run for an analytical '
                        'model by least_squares, else one_step)')
    parser.add_argument('--model', type=Path, metavar='MODEL',
                        help='for a hybrid: the analytical model that it stands on, with its '
                        'effects, instead of a fresh fit')
    parser.add_argument('--fix', action='append', default=[], type=assignment,
                        metavar='NAME=VALUE', help='hold a parameter at a known value, as '
                        'k_1=1.093, and fit the others; may be repeated')
    parser.add_argument('--curve', type=Path, metavar='CSV',
                        help='flow characteristic of the valve servo, opening against flow: its '
                        'end is the end of the travel in the model, saturation at the stem')
    networks = parser.add_argument_group('networks', 'the defaults are those of [B19]')
    networks.add_argument('--hidden', type=widths, metavar='WIDTHS',
                          help='of the hidden layers (default: 77,77; of a hybrid 80)')
    networks.add_argument('--epochs', type=int, default=500, help='default: %(default)s')
    networks.add_argument('--search', action='store_true',
                          help='search the structure, 1 or 2 layers of 1 to 100 units; it is kept '
                          'in MODEL.search.jsonl, and goes on from there if interrupted')
    networks.add_argument('--device', default='cpu', help='cpu or cuda (default: %(default)s)')
    add_seed_argument(parser)


def widths(text: str) -> tuple[int, ...]:
    """Read the widths of hidden layers.

    Raises:
        argparse.ArgumentTypeError: it is not of the form 77,77.
    """
    if not all(width.isdecimal() and int(width) > 0 for width in text.split(',')):
        raise argparse.ArgumentTypeError(f'{text!r} should read like 77,77')
    return tuple(int(width) for width in text.split(','))


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Fit a model and write it.

    Returns:
        The model's path, its parameters, its errors on both parts, and between which errors
        any one-step fit must lie, all in the output's unit.
    """
    from hydro_twin.commands.provenance import provenance
    from hydro_twin.fitting.network import check_device
    from hydro_twin.fitting.refit import bounds_of, errors_of
    from hydro_twin.model import Model, read_model, write_model
    from hydro_twin.predictors.analytical import Analytical

    if not args.output.absolute().parent.is_dir():
        raise UserError(f'{args.output}: there is no folder {args.output.parent}')
    if args.epochs < 1:
        raise UserError(f'--epochs {args.epochs}: at least one is needed')
    rig = rig_from(args)
    plant = rig.plant
    if args.predictor != 'analytical':
        check_device(args.device)
    if args.predictor == 'analytical' and (args.hidden or args.search):
        raise UserError('--hidden and --search are for networks: --predictor mlp or hybrid')
    if args.predictor == 'mlp' and (args.criterion or args.method != 'least_squares' or args.fix
                                    or args.curve):
        raise UserError('--method, --criterion, --fix and --curve are for physical parameters; '
                        'an MLP has none')
    if args.model and args.predictor != 'hybrid':
        raise UserError('--model is what a hybrid stands on: it needs --predictor hybrid')
    if args.model and (args.fix or args.curve):
        raise UserError('--fix and --curve are for a fresh fit; --model has its parameters')
    plant.holding(dict(args.fix))
    criterion = args.criterion or (
        'free_run' if (args.predictor, args.method) == ('analytical', 'least_squares')
        else 'one_step')
    train, test = train_and_test(args, rig)
    bounds = bounds_of(train, test, plant)
    model = Model(
        plant, {}, rig.constants, plant.sample_time, args.predictor,
        provenance=provenance(train.sources, test.sources if args.test else (), args.seed))
    if args.curve:
        from hydro_twin.valve.flow_characteristic import read_characteristic
        from hydro_twin.valve.limit import with_limit

        model = with_limit(model, read_characteristic(args.curve))
    known: Identifiability | None = None
    hidden: tuple[int, ...] = ()
    if args.model:
        model = _on(read_model(args.model), model)
    elif args.predictor != 'mlp':
        with progress('fitting the physics'):
            physics = _physics(args, train, model, criterion)
        known = physics.known
        model = replace(model, parameters=physics.estimates, provenance={
            **model.provenance, 'method': args.method, 'criterion': criterion})
    if args.predictor == 'analytical':
        errors = errors_of(Analytical(model), train, test)
    else:
        from hydro_twin.predictors.hybrid import NetworkPredictor
        from hydro_twin.predictors.network import save_network

        network = _network(args, train, model)
        hidden = network.hidden
        weights = args.output.with_suffix('.safetensors')
        model = replace(model, network=weights.name)
        errors = errors_of(NetworkPredictor(model, network), train, test)
        save_network(network, weights)
    write_model(replace(model, errors={'after': errors}), args.output)

    units = {p.name: p.unit for p in plant.parameters}
    return {
        'model': str(args.output),
        'unit': plant.output.unit,
        'parameters': {name: {'value': e.value, 'unit': units[name], 'std_error': e.std_error,
                              'identifiable': e.identifiable, 'held': e.held}
                       for name, e in model.parameters.items()},
        'hidden': list(hidden),
        'at_bound': list(known.at_bound) if known else [],
        'combinations': dict(known.combinations) if known else {},
        'train': _part(errors, 'train'),
        'test': _part(errors, 'test'),
        **bounds,
    }


def _physics(args: argparse.Namespace, train: Recording, model: Model, criterion: str) -> Physics:
    """Fit the physical parameters by the method asked for."""
    held = dict(args.fix)
    if args.method == 'network':
        from hydro_twin.studies.l18.network_fit import fit_network

        return fit_network(train, model.plant, held, args.seed)
    from hydro_twin.fitting.refit import fit_physics

    return fit_physics(train, model.plant, model.constants, args.method, criterion, args.seed,
                       held, model.placed)


def _on(base: Model, model: Model) -> Model:
    """Put a hybrid on the analytical part of another model.

    Raises:
        UserError: that is of another plant or sample time, or has no analytical part.
    """
    if (base.plant.name, base.sample_time) != (model.plant.name, model.sample_time):
        raise UserError(f'--model is of a {base.plant.name} at {base.sample_time:g} s, not of a '
                        f'{model.plant.name} at {model.sample_time:g} s')
    if base.kind == 'mlp':
        raise UserError('--model is an MLP, without the physics that a hybrid stands on')
    return replace(base, kind=model.kind, provenance=model.provenance)


def _network(args: argparse.Namespace, train: Recording, model: Model) -> Network:
    """Train the network of a model, of the structure asked for or found."""
    from hydro_twin.fitting.network import HYBRID, Job, Settings, train_batch
    from hydro_twin.fitting.refit import network_problem
    from hydro_twin.fitting.structure_search import choose, REPEATS, structure_search, STRUCTURES

    problem = network_problem(train, model)
    settings = replace(HYBRID if model.kind == 'hybrid' else Settings(), epochs=args.epochs)
    if args.hidden:
        settings = replace(settings, hidden=args.hidden)
    if args.search:
        log = args.output.with_suffix('.search.jsonl')
        with progress('searching the structure', len(STRUCTURES) * REPEATS) as tick:
            scores = structure_search(problem, settings, log, args.seed, args.device,
                                      trial_done=tick)
        settings = replace(settings, hidden=choose(scores, problem.regressors.shape[1]))
    with progress('training the network', args.epochs) as tick:
        return train_batch(problem, [Job(settings, args.seed)], args.device, tick)[0].network


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
                'held' if p['held'] else 'at its bound' if name in result['at_bound'] else
                'not identifiable' if not p['identifiable'] else 'unknown')
            table.add_row(name, f'{p["value"]:.5g}', error, p['unit'])
        console.print(table)
    for name, error in result['combinations'].items():
        if error is not None:
            console.print(f'{name} is known to {100 * error:.2g} %, its members are not',
                          highlight=False)
    if result['hidden']:
        console.print(f'hidden layers: {", ".join(map(str, result["hidden"]))}', highlight=False)
    table = Table(f'RMS error, {result["unit"]}', 'train', 'test')
    for mode in ('one_step', 'free_run'):
        table.add_row(mode.replace('_', ' '),
                      *(f'{result[part][mode]:.4g}' for part in ('train', 'test')))
    for bound, says in (('unconstrained', 'one step, no physics'),
                        ('persistence', 'one step, last sample')):
        table.add_row(says, *(f'{result[bound][part]:.4g}' for part in ('train', 'test')))
    console.print(table)
    console.print(f'model written to {result["model"]}')
