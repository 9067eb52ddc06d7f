"""A hydraulic cylinder driven by a valve or a pump: a lag, a speed gain, an integrator."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_twin.plants.plant import Laws, Parameter, Plant, Port, Signal


def laws(p: Mapping[str, float]) -> Laws:
    """State-space form of tau q' + q = command, x' = K_v q; states: q [command], x [m]."""
    tau, K_v = p['tau'], p['K_v']
    return Laws(
        A=np.array([[-1.0 / tau, 0.0], [K_v, 0.0]]),
        B=np.array([[1.0 / tau], [0.0]]),
        E=np.array([[1.0 / tau, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, K_v, 1.0, 0.0]]),
        port_x=np.array([[0.0, 0.0], [-1.0 / tau, 0.0], [1.0, 0.0], [K_v, 0.0], [0.0, 1.0]]),
        port_u=np.array([[1.0], [1.0 / tau], [0.0], [0.0], [0.0]]),
        port_d=np.array([
            [0.0, 0.0, 0.0, 0.0, 0.0],
            [1.0 / tau, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, K_v, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0],
        ]),
        signal_x=np.array([[1.0, 0.0], [0.0, 1.0]]),
        signal_u=np.zeros((2, 1)),
        signal_d=np.array([[0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0]]),
    )


CYLINDER = Plant(
    name='cylinder',
    title='hydraulic cylinder',
    sample_time=0.002,
    inputs=(Signal('command', 'opening of the valve or speed of the pump', '1', held=True),),
    output=Signal('x', 'position of the piston', 'm'),
    states=('q', 'x'),
    parameters=(
        Parameter('tau', 'lag of the valve or pump', 's', 1e-3, 1.0, 1e-4, 1e2),
        Parameter('K_v', 'speed per command', 'm/s', 1e-6, 1e1, 1e-9, 1e3),
    ),
    constants=(),
    ports=(
        Port('command', 'command', '1', 'command before the valve or pump'),
        Port('spool', 'rate', '1/s', 'speed of the valve or pump'),
        Port('spool', 'opening', '1', 'opening, or speed of the pump'),
        Port('piston', 'speed', 'm/s', 'speed of the piston', {'opening': '1', 'position': 'm'}),
        Port('sensor', 'sensor', 'm', 'position as measured'),
    ),
    laws=laws,
    at_rest=('q',),
    start_up=0.1,                               # three lags of a valve, some 30 ms
)
