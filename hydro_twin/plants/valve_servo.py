"""The turbine valve servo of [L18]: converter, actuator and lag under unit feedback."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_twin.plants.plant import Laws, Parameter, Plant, Port, Signal


def laws(p: Mapping[str, float]) -> Laws:
    """State-space form of the loop of [L18] eq. 1, without its nonlinear part.

    Error e = k_1 (command - y); converter T_y c' + c = e; actuator T_c a' = c;
    lag tau y' + y = a. States: c, a, y, all in units of nominal full opening. This closes to
    Y/U = k_1 / (T_c T_y tau s^3 + T_c (T_y + tau) s^2 + T_c s + k_1).
    """
    T_y, T_c, tau, k_1 = p['T_y'], p['T_c'], p['tau'], p['k_1']
    return Laws(
        A=np.array([
            [-1.0 / T_y, 0.0, -k_1 / T_y],
            [1.0 / T_c, 0.0, 0.0],
            [0.0, 1.0 / tau, -1.0 / tau],
        ]),
        B=np.array([[k_1 / T_y], [0.0], [0.0]]),
        #            command  converter  pilot  actuator  linkage  stem  sensor
        E=np.array([
            [k_1 / T_y, k_1 / T_y, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0 / T_c, 1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0 / tau, 0.0, 0.0],
        ]),
        port_x=np.array([
            [0.0, 0.0, 0.0],                # command
            [0.0, 0.0, -1.0],               # converter: command - y
            [1.0, 0.0, 0.0],                # pilot: c
            [1.0 / T_c, 0.0, 0.0],          # actuator: a'
            [0.0, 1.0, 0.0],                # linkage: a
            [0.0, 0.0, 1.0],                # stem: y
            [0.0, 0.0, 1.0],                # sensor
        ]),
        port_u=np.array([[1.0], [1.0], [0.0], [0.0], [0.0], [0.0], [0.0]]),
        port_d=np.array([
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0 / T_c, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        ]),
        signal_x=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        signal_u=np.zeros((2, 1)),
        signal_d=np.zeros((2, 7)),
    )


VALVE_SERVO = Plant(
    name='valve_servo',
    title='turbine valve servo',
    sample_time=0.002,
    inputs=(Signal('command', 'opening asked for', '1', held=True),),
    output=Signal('opening', 'opening of the valve', '1'),
    states=('c', 'a', 'y'),
    parameters=(                            # box: T_y and T_c as published in [L18], others wide
        Parameter('T_y', 'time constant of the converter', 's', 1e-2, 3e-2, 1e-4, 1e2),
        Parameter('T_c', 'time constant of the actuator', 's', 0.1, 0.5, 1e-3, 1e3),
        Parameter('tau', 'lag that stands for play and friction', 's', 1e-4, 3e-2, 1e-6, 1e2),
        Parameter('k_1', 'correction coefficient', '1', 0.5, 2.0, 1e-3, 1e3),
    ),
    constants=(),
    ports=(
        Port('command', 'command', '1', 'opening asked for'),
        Port('converter', 'opening', '1', 'difference of command and opening'),
        Port('pilot', 'pilot', '1', 'opening of the pilot valve, which sets the speed'),
        Port('actuator', 'speed', '1/s', 'speed of the actuator',
             {'opening': '1', 'position': '1'}),
        Port('linkage', 'linkage', '1', 'opening that the actuator asks of rod and hinge'),
        Port('stem', 'stem', '1', 'opening of the valve, beyond what is fed back'),
        Port('sensor', 'sensor', '1', 'opening as measured'),
    ),
    laws=laws,
    combinations=({'T_c': 1, 'k_1': -1},),      # Y/U holds them only as T_c / k_1
    at_rest=('a', 'y'),
    start_up=0.1,                               # five time constants of the converter, some 20 ms
    output_range=(0.0, 1.0),                    # shut to open
)
