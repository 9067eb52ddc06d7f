"""A positioning axis: a mass with viscous friction moved by a force."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_twin.plants.plant import Laws, Parameter, Plant, Port, Signal


def laws(p: Mapping[str, float]) -> Laws:
    """State-space form of M x'' + F_v x' = force; states: v [m/s], x [m]."""
    M, F_v = p['M'], p['F_v']
    return Laws(
        A=np.array([[-F_v / M, 0.0], [1.0, 0.0]]),
        B=np.array([[1.0 / M], [0.0]]),
        E=np.array([[1.0 / M, 1.0 / M, 0.0], [0.0, 0.0, 0.0]]),
        port_x=np.array([[0.0, 0.0], [-F_v, 0.0], [0.0, 1.0]]),
        port_u=np.array([[1.0], [1.0], [0.0]]),
        port_d=np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        signal_x=np.eye(2),
        signal_u=np.zeros((2, 1)),
        signal_d=np.zeros((2, 3)),
    )


POSITIONING = Plant(
    name='positioning',
    title='positioning axis',
    sample_time=0.001,
    inputs=(Signal('force', 'force of the drive', 'N', held=True),),
    output=Signal('x', 'position', 'm'),
    states=('v', 'x'),
    parameters=(
        Parameter('M', 'moving mass', 'kg', 1.0, 1e3, 1e-4, 1e6),
        Parameter('F_v', 'viscous friction', 'N s/m', 1.0, 1e4, 1e-4, 1e7),
    ),
    constants=(),
    ports=(
        Port('command', 'command', 'N', 'force asked of the drive'),
        Port('motor', 'force', 'N', 'force on the mass', {'velocity': 'm/s', 'position': 'm'}),
        Port('sensor', 'sensor', 'm', 'position as measured'),
    ),
    laws=laws,
    at_rest=('x',),
    start_up=0.05,              # shows position and velocity of the mass, which it does not forget
)
