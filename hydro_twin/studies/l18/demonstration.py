"""Make the sample recordings of the valve: steps, steps into the limit, and an event.

Run it as `python -m hydro_twin.studies.l18.demonstration FOLDER`. The servo is as published in
[L18]; noise and resolution are those of a plant's own data acquisition.
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

import numpy as np

from hydro_twin.errors import UserError
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.recording.series import Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording
from hydro_twin.simulation.sensor import measure
from hydro_twin.simulation.simulate import simulate
from hydro_twin.studies.l18.closed_loop import run_loop
from hydro_twin.studies.l18.event import load_loop_constants, simulated_frequency
from hydro_twin.studies.l18.flow_characteristic import default_characteristic, FlowCharacteristic
from hydro_twin.studies.l18.limit import with_limit
from hydro_twin.studies.l18.servo_model import published

NOISE = 5e-4            # standard deviation, of nominal
RESOLUTION = 5e-4       # of nominal: 11 bits
FREQUENCY_RESOLUTION = 1e-3     # Hz
EVENT_SAMPLE_TIME = 0.05        # s
LOAD = 1.0              # of nominal: with 6 % more the valve is at the end of its travel
STEPS = (0.0, 0.6, 0.4, 0.8, 0.7, 0.9, 0.5, 0.5)        # commands, below the limit
LIMIT_STEPS = (0.0, 0.9, 1.08, 0.8, 1.1, 0.95, 1.09, 0.7)       # with d_1 = 1.05
HOLD = 1.0              # s
BEGIN = 1_000_000_000_000       # stamp of the first sample [ns]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the recordings; 2 after an error of the user's."""
    parser = argparse.ArgumentParser(
        prog='python -m hydro_twin.studies.l18.demonstration',
        description='Writes the bags valve_steps, valve_limit and valve_event.')
    parser.add_argument('folder', type=Path, metavar='FOLDER', help='where the bags go')
    args = parser.parse_args(arguments)
    try:
        write_demonstration(args.folder)
    except (UserError, OSError) as error:
        print(f'{parser.prog}: {error}', file=sys.stderr)
        return 2
    return 0


def write_demonstration(folder: Path) -> None:
    """Write the three bags.

    Raises:
        BagError: one is there already, or the folder is not.
    """
    curve = default_characteristic()
    rng = np.random.default_rng(2018)
    servo_signals = load_signals('valve_servo', ('command', 'opening'))
    loop_signals = load_signals('frequency_control', ('frequency', 'power', 'opening'))
    about = {'origin': 'simulated: valve servo with the parameters of [L18], '
                       'python -m hydro_twin.studies.l18.demonstration'}
    for name, levels in (('valve_steps', STEPS), ('valve_limit', LIMIT_STEPS)):
        steps = measured(simulated_steps(levels, curve), ['opening'], rng)
        write_recording(folder / name, [steps], servo_signals, about)
    event = measured(simulated_event(curve), ['opening', 'power'], rng)
    write_recording(folder / 'valve_event', [event],
                    {**loop_signals, 'command': servo_signals['command']}, about)


def simulated_steps(levels: Sequence[float], curve: FlowCharacteristic) -> Series:
    """Integrate the published servo, with the limit of the curve, over held commands."""
    model = with_limit(published(), curve)
    last = len(levels) - 1
    held = np.array(levels)
    return simulate(
        model.plant, model.values, model.effects,
        {'command': lambda t: held[np.minimum((t / HOLD + 1e-9).astype(int), last)]},
        duration=HOLD * len(levels), start=BEGIN)


def simulated_event(curve: FlowCharacteristic) -> Series:
    """Simulate a fall of the grid's frequency in closed loop, recorded every 50 ms."""
    servo = Analytical(with_limit(published(), curve))
    constants = load_loop_constants()
    frequency = simulated_frequency(constants['f_n'], servo.sample_time)
    run = run_loop(servo, curve, frequency, LOAD, constants)
    every = slice(None, None, round(EVENT_SAMPLE_TIME / servo.sample_time))
    return Series({
        'frequency': np.round(frequency[every] / FREQUENCY_RESOLUTION) * FREQUENCY_RESOLUTION,
        'command': run.command[every],
        'opening': run.opening[every],
        'power': run.power[every],
    }, EVENT_SAMPLE_TIME, BEGIN)


def measured(series: Series, signals: Sequence[str], rng: np.random.Generator) -> Series:
    """Give signals the noise and the resolution of a plant's data acquisition."""
    for signal in signals:
        series, _ = measure(series, signal, None, NOISE, RESOLUTION, rng)
    return series


if __name__ == '__main__':
    sys.exit(main())
