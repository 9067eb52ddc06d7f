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
    from hydro_twin.fitting.network import Settings
    from hydro_twin.fitting.refit import Physics
    from hydro_twin.model import Model
    from hydro_twin.predictors.network import Network
    from hydro_twin.predictors.scores import Errors
    from hydro_twin.recording.series import Recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bag_arguments(parser)
    add_rig_arguments(parser)
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='MODEL',
                        help='the model file to write; network weights go beside it')
    parser.add_argument('--predictor', choices=('analytical', 'mlp', 'gru', 'hybrid'),
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
                          help='of the hidden layers (default: 77,77; of a hybrid 80; of a GRU, '
                          'which has one layer, 42)')
    networks.add_argument('--decay', type=decay,
                          help='weight decay, against the sum of squared scaled errors '
                          '(default: 5e-4; of a hybrid and a GRU 0)')
    networks.add_argument('--epochs', type=int, default=500, help='default: %(default)s')
    networks.add_argument('--search', action='store_true',
                          help='search the weight decay and the structure, 1 or 2 layers of 1 to '
                          '100 units, on a third of the training patterns; what --hidden or '
                          '--decay gives stays. It is kept in MODEL.search.jsonl, and goes on '
                          'from there if interrupted')
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
        The model's path, its parameters, its errors on both parts, and between which errors
        any one-step fit must lie, all in the output's unit.
    """
    from hydro_twin.commands.provenance import provenance
    from hydro_twin.fitting.network import check_device
    from hydro_twin.fitting.refit import bounds_of
    from hydro_twin.model import Model, read_model, WITHOUT_PHYSICS, write_model
    from hydro_twin.predictors.analytical import Analytical
    from hydro_twin.predictors.scores import errors_of

    if not args.output.absolute().parent.is_dir():
        raise UserError(f'{args.output}: there is no folder {args.output.parent}')
    if args.epochs < 1:
        raise UserError(f'--epochs {args.epochs}: at least one is needed')
    if args.predictor != 'analytical':
        check_device(args.device)
    if args.predictor == 'analytical' and (
            args.hidden or args.search or args.decay is not None):
        raise UserError('--hidden, --decay and --search are for networks: --predictor mlp, gru '
                        'or hybrid')
    if args.predictor == 'gru' and (args.search or len(args.hidden or (1,)) > 1):
        raise UserError('a GRU has one hidden layer, and --search is for mlp and hybrid')
    if args.predictor in WITHOUT_PHYSICS and (
            args.criterion or args.method != 'least_squares' or args.fix or args.curve):
        raise UserError('--method, --criterion, --fix and --curve are for physical parameters; '
                        f'an {args.predictor.upper()} has none'.replace('an G', 'a G'))
    if args.model and args.predictor != 'hybrid':
        raise UserError('--model is what a hybrid stands on: it needs --predictor hybrid')
    if args.model and (args.fix or args.curve):
        raise UserError('--fix and --curve are for a fresh fit; --model has its parameters')
    base = read_model(args.model) if args.model else None
    rig = rig_from(args, base)
    plant = rig.plant
    plant.holding(dict(args.fix))
    criterion = args.criterion or (
        'free_run' if (args.predictor, args.method) == ('analytical', 'least_squares')
        else 'one_step')
    train, test = train_and_test(args, rig)
    parts = {'train': train, 'test': test}
    bounds = bounds_of(train, test, plant)
    model = Model(
        plant, {}, rig.constants, train.sample_time, args.predictor,
        provenance=provenance(train.sources, test.sources if args.test else (), args.seed))
    if args.curve:
        from hydro_twin.valve.flow_characteristic import read_characteristic
        from hydro_twin.valve.limit import with_limit

        model = with_limit(model, read_characteristic(args.curve))
    known: Identifiability | None = None
    settings: Settings | None = None
    if base is not None:
        model = _on(base, model)
    elif args.predictor not in WITHOUT_PHYSICS:
        with progress('fitting the physics'):
            physics = _physics(args, train, model, criterion)
        known = physics.known
        model = replace(model, parameters=physics.estimates, notes=physics.notes, provenance={
            **model.provenance, 'method': args.method, 'criterion': criterion})
    if args.predictor == 'analytical':
        errors = errors_of(Analytical(model), parts)
    else:
        from hydro_twin.predictors.hybrid import NetworkPredictor
        from hydro_twin.predictors.network import save_network

        network, settings = _network(args, train, model)
        weights = args.output.with_suffix('.safetensors')
        model = replace(model, network=weights.name)
        errors = errors_of(NetworkPredictor(model, network), parts)
        save_network(network, weights)
    write_model(replace(model, errors={'after': errors}), args.output)

    units = {p.name: p.unit for p in plant.parameters}
    return {
        'model': str(args.output),
        'unit': plant.output.unit,
        'sample_time': model.sample_time,
        'parameters': {name: {'value': e.value, 'unit': units[name], 'std_error': e.std_error,
                              'identifiable': e.identifiable, 'held': e.held,
                              'at_bound': e.at_bound or None}
                       for name, e in model.parameters.items()},
        'hidden': list(settings.hidden) if settings else [],
        'decay': settings.decay if settings else None,
        'at_bound': [name for name, e in model.parameters.items() if e.at_bound],
        'notes': list(model.notes),
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
    """Put a hybrid on the analytical part of another model, at the clock of the recording.

    Raises:
        UserError: that model has no analytical part.
    """
    from hydro_twin.model import WITHOUT_PHYSICS

    if base.kind in WITHOUT_PHYSICS:
        raise UserError(f'--model is of kind {base.kind}, without the physics that a hybrid '
                        'stands on')
    physics = replace(base, kind='analytical').at(model.sample_time)
    return replace(physics, kind=model.kind, provenance=model.provenance)


def _network(
    args: argparse.Namespace, train: Recording, model: Model,
) -> tuple[Network, Settings]:
    """Train the network of a model, of the settings asked for or found."""
    from hydro_twin.fitting.network import Job, SETTINGS, train_batch
    from hydro_twin.fitting.network_search import DECAYS, search, STRUCTURES
    from hydro_twin.fitting.refit import network_problem

    problem = network_problem(train, model)
    settings = replace(SETTINGS[model.kind], epochs=args.epochs)
    if args.hidden:
        settings = replace(settings, hidden=args.hidden)
    if args.decay is not None:
        settings = replace(settings, decay=args.decay)
    if args.search:
        with progress('searching the settings') as tick:
            rounds = search(problem, settings, args.output.with_suffix('.search.jsonl'),
                            args.seed, args.device,
                            (settings.decay,) if args.decay is not None else DECAYS,
                            (settings.hidden,) if args.hidden else STRUCTURES, trial_done=tick)
        settings = rounds[-1].chosen
    with progress('training the network', args.epochs) as tick:
        trained = train_batch(problem, [Job(settings, args.seed)], args.device, tick)[0]
    return trained.network, settings


def _part(errors: Errors, name: str) -> dict[str, float]:
    """Take the errors of one part."""
    return {mode: parts[name] for mode, parts in errors.items()}


def show(result: dict[str, Any], console: Console) -> None:
    """Print parameters and errors."""
    from rich.table import Table

    from hydro_twin.fitting.refit import BIASED

    if result['parameters']:
        table = Table('parameter', 'value', 'standard error', 'unit')
        for name, p in result['parameters'].items():
            error = f'{p["std_error"]:.2g}' if p['std_error'] is not None else (
                'held' if p['held'] else
                f'at its {p["at_bound"]} bound' if p['at_bound'] else
                'not identifiable' if not p['identifiable'] else
                'biased' if BIASED in result['notes'] else 'unknown')
            table.add_row(name, f'{p["value"]:.5g}', error, p['unit'])
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
    for mode in ('one_step', 'free_run'):
        table.add_row(mode.replace('_', ' '),
                      *(f'{result[part][mode]:.4g}' for part in ('train', 'test')))
    for bound, says in (('unconstrained', 'one step, no physics'),
                        ('persistence', 'one step, last sample')):
        table.add_row(says, *(f'{result[bound][part]:.4g}' for part in ('train', 'test')))
    console.print(table)
    console.print(f'model written to {result["model"]}, sample time {result["sample_time"]:g} s')
