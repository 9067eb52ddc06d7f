"""The event that is simulated where none was recorded, and the constants of its loop."""
from __future__ import annotations

from pathlib import Path

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import UserError
from hydro_twin.recording.signals import load_parameters, number
from hydro_twin.share import share_folder
from hydro_twin.studies.l18 import power_control, turbine

CONSTANTS = (*power_control.CONSTANTS, *turbine.CONSTANTS)
LOAD = 0.89             # of nominal, at rest: figure 13 of [L18] goes from 890 to 950 MW
EVENT = ((0.0, 0.0), (5.0, 0.0), (8.0, -0.2), (90.0, -0.2))     # time [s], deviation [Hz]


def load_loop_constants(config: Path | None = None) -> dict[str, float]:
    """Load the constants of controller and turbine.

    Raises:
        UserError: the file cannot be read, or a constant is unknown or not a number.
    """
    values = {constant.name: constant.value for constant in CONSTANTS}
    path = config or share_folder() / 'config' / 'frequency_control.yaml'
    for key, value in load_parameters(path).items():
        root, _, name = key.partition('.')
        if root != 'constants':
            continue
        if name not in values:
            raise UserError(f'{path}: no constant {name!r}; there are {", ".join(values)}')
        values[name] = number(value, f'{path}: {key}')
        if values[name] < 0 or (values[name] == 0 and not name.startswith(('K_', 'dead'))):
            raise UserError(f'{path}: {key} = {values[name]:g} must be above zero')
    return values


def simulated_frequency(f_n: float, sample_time: float) -> FloatArray:
    """Make the course of frequency of an event: at rest, a fall of 0.2 Hz in 3 s, and after."""
    times, deviations = np.transpose(EVENT)
    deviation = np.interp(np.arange(0, times[-1], sample_time), times, deviations)
    return np.asarray(f_n + deviation)
