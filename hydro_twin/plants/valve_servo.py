"""The turbine valve servo of [L18]: converter, actuator and lag under unit feedback."""
from __future__ import annotations

from types import SimpleNamespace

from hydro_twin.plants.equations import Linear, Ports
from hydro_twin.plants.plant import Parameter, Plant, Port, Signal


def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Ports
              ) -> dict[str, Linear]:
    """Return the rates of the loop of [L18] eq. 1, all states in nominal full openings.

    Closed, it is Y/U = k_1 / (T_c T_y tau s^3 + T_c (T_y + tau) s^2 + T_c s + k_1).
    """
    command = port('command', u.command)
    error = port('converter', command - x.y)
    c = port('pilot', x.c)
    speed = port('actuator', c / p.T_c, opening=x.c, position=x.a)
    a = port('linkage', x.a)
    stem = port('stem', x.y)
    port('sensor', stem)
    port.sensor('servomotor', x.a)
    return {
        'c': (p.k_1 * error - x.c) / p.T_y,
        'a': speed,
        'y': (a - x.y) / p.tau,
    }


VALVE_SERVO = Plant(
    name='valve_servo',
    title='turbine valve servo',
    sample_time=0.002,
    inputs=(Signal('command', 'opening asked for', '1', held=True),),
    output=Signal('opening', 'opening of the valve', '1'),
    sensors=(Signal('servomotor', 'position of the servomotor', '1'),),
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
    equations=equations,
    combinations=({'T_c': 1, 'k_1': -1},),      # Y/U holds them only as T_c / k_1
    at_rest=('a', 'y'),
    start_up=0.1,                               # five time constants of the converter, some 20 ms
    output_range=(0.0, 1.0),                    # shut to open
)
