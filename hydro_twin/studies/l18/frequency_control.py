"""Primary frequency control with a linear and with a nonlinear valve servo, side by side."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.as_json import as_json
from hydro_twin.files import write_whole
from hydro_twin.model import Model
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.progress import progress
from hydro_twin.recording.read import read_recording
from hydro_twin.recording.signals import load_signals
from hydro_twin.studies.l18.closed_loop import agreement, Run, run_loop
from hydro_twin.studies.l18.event import CONSTANTS, LOAD, load_loop_constants, simulated_frequency
from hydro_twin.studies.l18.flow_characteristic import (
    default_characteristic,
    FlowCharacteristic,
    read_characteristic,
)
from hydro_twin.studies.l18.limit import with_limit
from hydro_twin.studies.l18.power_control import power_asked
from hydro_twin.studies.l18.servo_model import (
    published,
    read_servo,
    without_nonlinear_factors,
)


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


def compare(bag: Path | None, folder: Path, model: Path | None = None, curve: Path | None = None,
            config: Path | None = None, load: float | None = None) -> dict[str, Any]:
    """Simulate an event with both servos; writes comparison.json and comparison.png.

    Args:
        bag: recording of frequency, opening and power, or None for a fall of 0.2 Hz.
        folder: where to write.
        model: model file of the nonlinear servo; one without a limit at the stem gets d_1.
        curve: CSV file of the flow characteristic.
        config: ROS parameter file with signals and constants.
        load: power at rest and nominal frequency [1]; by default that of the recording, else
            that of the paper's figure 13.

    Returns:
        What comparison.json holds.

    Raises:
        UserError: a file cannot be read or used, or the curve does not reach the load.
    """
    characteristic = read_characteristic(curve) if curve else default_characteristic()
    constants = load_loop_constants(config)
    servo = with_limit(read_servo(model) if model else published(), characteristic)
    T = servo.sample_time
    measured = _read(bag, config, T) if bag else None
    frequency = measured.frequency if measured else simulated_frequency(constants['f_n'], T)
    if load is None:
        load = _load(measured, T, constants) if measured else LOAD
    runs = run_both(servo, characteristic, frequency, load, constants)
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
    write_whole(folder / 'comparison.json', json.dumps(as_json(result), indent=2).encode())
    return result


def run_both(servo: Model, curve: FlowCharacteristic, frequency: FloatArray, load: float,
             constants: Mapping[str, float]) -> dict[str, Run]:
    """Run the loop with a servo without its nonlinear factors, and with them.

    See `run_loop` for the arguments.

    Returns:
        The runs, 'linear' and 'nonlinear'.
    """
    runs = {}
    with progress('simulating', 2) as done:
        for name, model in (('linear', without_nonlinear_factors(servo)), ('nonlinear', servo)):
            runs[name] = run_loop(Analytical(model), curve, frequency, load, constants)
            done()
    return runs


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
    from matplotlib.figure import Figure

    from hydro_twin.report.picture import write_picture

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
    write_picture(figure, path)
