"""hydro-twin replay: a model over a recorded bag, or the bag played into ROS."""
from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import add_config_argument, check_file, check_folder
from hydro_twin.commands.verb import Verb
from hydro_twin.errors import UserError
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from rich.console import Console

    from hydro_twin.arrays import FloatArray
    from hydro_twin.recording.rig import Rig
    from hydro_twin.recording.series import Recording, Series

TOPIC = '/hydro_twin/{mode}/prediction'     # as the node's ~/NAME/prediction


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('bag', type=Path, metavar='BAG', help='a rosbag2 recording')
    parser.add_argument('--model', type=Path, metavar='MODEL',
                        help='the model file to run; needed except with --publish')
    parser.add_argument('-o', '--output', type=Path, metavar='OUT',
                        help='a bag to make: the recording, with the predictions')
    parser.add_argument('--picture', type=Path, metavar='PNG',
                        help='a picture to make: measured against free run, and the errors')
    parser.add_argument('--beside', action='append', default=[], type=Path, metavar='MODEL',
                        help='another model in the picture, may be repeated')
    add_config_argument(parser)
    parser.add_argument('--publish', action='store_true',
                        help="play the bag's topics into ROS instead, to drive a live node")
    parser.add_argument('--rate', type=float,
                        help='with --publish: playback speed (default: 1)')
    parser.add_argument('--loop', action='store_true',
                        help='with --publish: repeat until stopped')
    parser.add_argument('--clock', action='store_true',
                        help="with --publish: the bag's time on /clock, for use_sim_time")
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[], metavar='...',
                        help='with --publish, and last of all: ROS arguments, as -r FROM:=TO')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Run the model over the bag, or play the bag.

    Returns:
        Samples, series and errors, each in the output's unit; or the messages played by topic.

    Raises:
        UserError: an option is not for what is asked, or a file cannot be written.
    """
    playing = {'--rate': args.rate is not None, '--loop': args.loop, '--clock': args.clock,
               '--ros-args': args.ros_args}
    running = {'--model': args.model, '-o': args.output, '--picture': args.picture,
               '--beside': args.beside, '--config': args.config}
    if args.publish:
        _refuse(running, 'not with --publish, which plays the bag as it is')
        from hydro_twin.ros.player import play
        return {'played': play(args.bag, 1.0 if args.rate is None else args.rate, args.loop,
                               args.clock, args.ros_args)}
    _refuse(playing, 'for --publish only')
    if args.model is None:
        raise UserError('a --model is needed, or --publish')
    if args.beside and args.picture is None:
        raise UserError('--beside is for a --picture')
    return _replay(args.bag, args.model, args.output, args.config, args.picture, args.beside)


def _refuse(options: Mapping[str, Any], why: str) -> None:
    """Refuse options that are given; each has its value."""
    if given := [name for name, value in options.items() if value]:
        raise UserError(f'{", ".join(given)}: {why}')


def _replay(bag: Path, model: Path, output: Path | None, config: Path | None,
            picture: Path | None, beside: Sequence[Path]) -> dict[str, Any]:
    from hydro_twin import api
    from hydro_twin.model import load_predictor, read_model
    from hydro_twin.recording.rig import rig_of

    if output is not None and output.exists():
        raise UserError(f'{output} exists already: it is not overwritten')
    if picture is not None:
        check_file(picture, 'picture')
    if output is not None:
        check_folder(output)
    as_fitted = read_model(model)
    plant = as_fitted.plant
    for path in beside:
        if (name := read_model(path).plant.name) != plant.name:
            raise UserError(f'{path}: a model of {name}, not of {plant.name}')
    rig = rig_of(plant, config, model=as_fitted)
    data = api.read_data([bag], (), rig, progress)
    sample_time = data.recording.sample_time
    predictors = {path: load_predictor(path, sample_time, rig.follow)
                  for path in (model, *beside)}
    with progress('replaying'):
        replayed = api.replay(data, predictors[model])
    result = replayed.summary()
    if output is not None:
        _write(bag, output, data.recording, replayed.predictions, rig)
        result['output'] = str(output)
    if picture is not None:
        from hydro_twin.report.picture import draw, write_picture

        replays = {str(path): api.replay(data, predictors[path]) for path in beside}
        replays[str(model)] = replayed
        runs = {name: one.predictions['free_run'] for name, one in replays.items()}
        errors = {name: one.summary()['free_run']['rmse'] for name, one in replays.items()}
        write_picture(draw(data.recording, plant, runs, errors), picture)
        result['picture'] = str(picture)
    return result


def _write(bag: Path, output: Path, recording: Recording,
           predictions: Mapping[str, Sequence[FloatArray]], rig: Rig) -> None:
    """Write the bag again, with the predictions on topics of their own."""
    from hydro_twin.live.writer import FIELDS, TYPE
    from hydro_twin.recording.signals import SignalMap
    from hydro_twin.recording.write import add_to_copy

    field = FIELDS.get(rig.plant.output.unit, 'position')
    beside = rig.signals[rig.plant.output.name]
    signals = {mode: SignalMap(TOPIC.format(mode=mode), TYPE, f'{field}[0]')
               for mode in predictions}
    series = [_predicted(one, {mode: predictions[mode][k] for mode in predictions})
              for k, one in enumerate(recording.series)]
    add_to_copy(bag, output, series, signals, beside)


def _predicted(series: Series, predictions: dict[str, FloatArray]) -> Series:
    """Make a series of the predictions, from where both begin to where one diverges."""
    import numpy as np

    known = np.all([np.isfinite(prediction) for prediction in predictions.values()], axis=0)
    begin = int(np.argmax(known))
    end = begin + int(np.argmin([*known[begin:], False]))
    return replace(series, columns=predictions).part(begin, end)


def show(result: dict[str, Any], console: Console) -> None:
    """Print the errors."""
    if 'played' in result:
        for topic, count in result['played'].items():
            console.print(f'{topic}: {count} messages')
        return
    from rich.table import Table

    from hydro_twin.predictors.scores import FIGURES

    unit = result['unit']
    console.print(f'{result["samples"]} samples in {result["series"]} series, '
                  f'{result["sample_time"]:g} s apart')
    table = Table('', f'RMS error, {unit}', 'fit, %')
    for mode in FIGURES:
        if mode not in result:
            continue
        fit = result[mode].get('fit_percent')
        table.add_row(mode.replace('_', ' '), f'{result[mode]["rmse"]:.4g}',
                      '' if fit is None else f'{fit:.2f}')
    table.add_row('persistence', f'{result["persistence"]["rmse"]:.4g}', '')
    console.print(table)
    sensors = list(result['outputs'].items())[1:]
    if sensors:
        table = Table('sensor, free run', 'unit', 'samples', 'RMS error', 'fit, %')
        for name, figures in sensors:
            table.add_row(name, figures['unit'], str(figures['samples']),
                          f'{figures["free_run"]["rmse"]:.4g}',
                          f'{figures["free_run"]["fit_percent"]:.2f}')
        console.print(table)
    if 'states' in result:
        table = Table('state, SI units', 'standard deviation', 'of the free run', 'ratio')
        for name, known in result['states'].items():
            free = known['free_run']
            table.add_row(name, f'{known["std"]:.3g}', '' if free is None else f'{free:.3g}',
                          '' if not free else f'{known["std"] / free:.2f}')
        console.print(table)
    if 'output' in result:
        console.print(f'predictions beside the input in {result["output"]}')
    if 'picture' in result:
        console.print(f'measured against predicted in {result["picture"]}')


VERB = Verb('replay', 'run a model over a recorded bag, or play the bag into ROS',
            add_arguments, run, show)
