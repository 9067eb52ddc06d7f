"""A process control valve with its positioner: the stem follows the command with a lag."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_twin.plants.plant import Laws, Parameter, Plant, Port, Signal


def laws(p: Mapping[str, float]) -> Laws:
    """State-space form of tau y' + y = K command; state: y [1]."""
    tau, K = p['tau'], p['K']
    return Laws(
        A=np.array([[-1.0 / tau]]),
        B=np.array([[K / tau]]),
        #            command  actuator  stem  sensor
        E=np.array([[K / tau, 1.0, 0.0, 0.0]]),
        port_x=np.array([[0.0], [-1.0 / tau], [1.0], [1.0]]),
        port_u=np.array([[1.0], [K / tau], [0.0], [0.0]]),
        port_d=np.array([
            [0.0, 0.0, 0.0, 0.0],
            [K / tau, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ]),
        signal_x=np.array([[1.0]]),
        signal_u=np.zeros((1, 1)),
        signal_d=np.zeros((1, 4)),
    )


CONTROL_VALVE = Plant(
    name='control_valve',
    title='process control valve',
    sample_time=1.0,
    inputs=(Signal('command', 'opening asked for', '1', held=True),),
    output=Signal('opening', 'opening of the valve', '1'),
    states=('y',),
    parameters=(
        Parameter('tau', 'lag of the positioner', 's', 0.3, 30.0, 0.1, 1e4),
        Parameter('K', 'stroke per command', '1', 0.5, 2.0, 1e-3, 1e3),
    ),
    constants=(),
    ports=(
        Port('command', 'command', '1', 'opening asked for'),
        Port('actuator', 'speed', '1/s', 'speed of the actuator', {'position': '1'}),
        Port('stem', 'stem', '1', 'opening of the valve'),
        Port('sensor', 'sensor', '1', 'opening as measured'),
    ),
    laws=laws,
    at_rest=(),
    start_up=10.0,                              # three lags of a positioner, some 3 s
    output_range=(0.0, 1.0),                    # shut to open
)
