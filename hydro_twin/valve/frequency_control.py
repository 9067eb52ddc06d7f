"""Compare a linear and a nonlinear valve servo in primary frequency control, from the shell.

Run it as `python -m hydro_twin.valve.frequency_control [BAG] -o DIR`.
"""
from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import json
from pathlib import Path
import sys
from typing import Any

import numpy as np

from hydro_twin.commands.common import progress
from hydro_twin.commands.main import plain
from hydro_twin.errors import UserError
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.recording.read import read_recording
from hydro_twin.recording.series import FloatArray
from hydro_twin.recording.signals import load_signals
from hydro_twin.valve.closed_loop import agreement, Run, run_loop
from hydro_twin.valve.event import CONSTANTS, LOAD, load_loop_constants, simulated_frequency
from hydro_twin.valve.files import write_whole
from hydro_twin.valve.flow_characteristic import default_characteristic, read_characteristic
from hydro_twin.valve.power_control import power_asked
from hydro_twin.valve.servo_model import published, read_servo, with_limit


@dataclass(frozen=True)
class Measured:
    """What a recording of an event holds, on the grid of the servo.

    Attributes:
        frequency: of the grid [Hz].
        opening, power: in units of nominal [1].
    """

    frequency: FloatArray
    opening: FloatArray
    power: FloatArray


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; 2 after an error of the user's."""
    parser = argparse.ArgumentParser(
        prog='python -m hydro_twin.valve.frequency_control',
        description='Simulates primary frequency control with the linear and the nonlinear valve '
                    'servo, and compares both with a recording where there is one.')
    parser.add_argument('bag', nargs='?', type=Path, metavar='BAG',
                        help='recording of frequency, opening and power; without it the frequency '
                             'falls by 0.2 Hz')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='DIR',
                        help='where comparison.json and comparison.png go')
    parser.add_argument('--model', type=Path, metavar='M',
                        help='model file of the servo (default: as published)')
    parser.add_argument('--curve', type=Path, metavar='CSV',
                        help='flow characteristic, opening against flow (default: a typical one)')
    parser.add_argument('--config', type=Path, metavar='FILE',
                        help='signals and constants (default: config/frequency_control.yaml)')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    args = parser.parse_args(arguments)
    try:
        result = compare(args.bag, args.output, args.model, args.curve, args.config)
    except (UserError, OSError) as error:
        print(f'{parser.prog}: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    if args.json:
        print(json.dumps(plain(result), allow_nan=False))
    else:
        show(result)
    return 0


def compare(bag: Path | None, folder: Path, model: Path | None = None, curve: Path | None = None,
            config: Path | None = None) -> dict[str, Any]:
    """Simulate an event with both servos; writes comparison.json and comparison.png.

    Args:
        bag: recording of frequency, opening and power, or None for a fall of 0.2 Hz.
        folder: where to write.
        model: model file of the nonlinear servo; one without a limit at the stem gets d_1.
        curve: CSV file of the flow characteristic.
        config: ROS parameter file with signals and constants.

    Returns:
        What comparison.json holds.

    Raises:
        UserError: a file cannot be read or used.
    """
    characteristic = read_characteristic(curve) if curve else default_characteristic()
    constants = load_loop_constants(config)
    nonlinear = with_limit(read_servo(model) if model else published(), characteristic)
    servos = {'linear': Analytical(replace(nonlinear, effects=())),
              'nonlinear': Analytical(nonlinear)}
    T = nonlinear.sample_time
    measured = _read(bag, config, T) if bag else None
    frequency = measured.frequency if measured else simulated_frequency(constants['f_n'], T)
    load = _load(measured, T, constants) if measured else LOAD
    runs = {}
    with progress('simulating', len(servos)) as done:
        for name, servo in servos.items():
            runs[name] = run_loop(servo, characteristic, frequency, load, constants)
            done()
    result: dict[str, Any] = {
        'bag': bag, 'model': model, 'd_1': characteristic.d_1, 'load': load,
        'constants': {c.name: {'value': constants[c.name], 'unit': c.unit, 'meaning': c.meaning}
                      for c in CONSTANTS},
        'steady': {name: {'opening': run.opening[-1], 'power': run.power[-1]}
                   for name, run in runs.items()},
    }
    reference = measured or runs['nonlinear']
    result['against'] = 'recording' if measured else 'nonlinear servo'
    result['agreement'] = {
        name: {'opening': agreement(reference.opening, run.opening),
               'power': agreement(reference.power, run.power)}
        for name, run in runs.items() if run is not reference}
    folder.mkdir(parents=True, exist_ok=True)
    _draw(frequency, T, measured, runs, folder / 'comparison.png')
    write_whole(folder / 'comparison.json', json.dumps(plain(result), indent=2).encode())
    return result


def _read(bag: Path, config: Path | None, sample_time: float) -> Measured:
    """Read the longest stretch of a recording."""
    names = ('frequency', 'power', 'opening')
    recording = read_recording([bag], load_signals('frequency_control', names, config), (),
                               sample_time)
    series = max(recording.series, key=len)
    return Measured(series['frequency'], series['opening'], series['power'])


def _load(measured: Measured, sample_time: float, constants: Mapping[str, float]) -> float:
    """Take the power over the first second, at rest, less what droop adds, as the load."""
    second = slice(round(1 / sample_time))
    frequency = float(measured.frequency[second].mean())
    return float(measured.power[second].mean()) - power_asked(frequency, 0.0, constants)


def _draw(frequency: FloatArray, sample_time: float, measured: Measured | None,
          runs: dict[str, Run], path: Path) -> None:
    """Draw frequency, opening and power, one above the other."""
    from io import BytesIO

    from matplotlib.figure import Figure

    time = sample_time * np.arange(len(frequency))
    figure = Figure(figsize=(8, 8), layout='constrained')
    top, *rest = figure.subplots(3, 1, sharex=True)
    top.plot(time, frequency, color='0.3')
    top.set(ylabel='frequency [Hz]', title='Primary frequency control')
    for axes, name in zip(rest, ('opening', 'power'), strict=True):
        if measured:
            axes.plot(time, getattr(measured, name), color='0.6', label='recorded')
        for label, run in runs.items():
            axes.plot(time, getattr(run, name), '--' if label == 'linear' else '-',
                      linewidth=1, label=f'{label} servo')
        axes.set_ylabel(f'{name} [1]')
        axes.legend()
    rest[-1].set_xlabel('time [s]')
    image = BytesIO()
    figure.savefig(image, format='png', dpi=120)
    write_whole(path, image.getvalue())


def show(result: Mapping[str, Any]) -> None:
    """Print fit degree and steady error of each servo."""
    from rich.console import Console
    from rich.table import Table

    table = Table('servo', 'signal', 'fit degree [%]', 'steady error [%]',
                  title=f'Against the {result["against"]}; d_1 = {result["d_1"]:g}')
    for servo, signals in result['agreement'].items():
        for signal, figures in signals.items():
            table.add_row(servo, signal, *(f'{value:.3f}' for value in figures.values()))
    Console().print(table)


if __name__ == '__main__':
    sys.exit(main())
