"""A process control valve with its positioner: the stem follows the command with a lag."""
from __future__ import annotations

from types import SimpleNamespace

from hydro_twin.plants.equations import Linear, Ports
from hydro_twin.plants.plant import Parameter, Plant, Port, Signal


def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Ports
              ) -> dict[str, Linear]:
    """Return the rate of a first-order lag, tau y' + y = K command."""
    command = port('command', u.command)
    force = port('spring', p.K * command - x.y)
    speed = port('actuator', force / p.tau, position=x.y)
    stem = port('stem', x.y)
    port('sensor', stem)
    return {'y': speed}


CONTROL_VALVE = Plant(
    name='control_valve',
    title='process control valve',
    sample_time=1.0,
    inputs=(Signal('command', 'opening asked for', '1', held=True),),
    output=Signal('opening', 'opening of the valve', '1'),
    states=('y',),
    parameters=(
        Parameter('tau', 'lag of the positioner', 's', 0.3, 30.0, 3e-3, 1e4,
                  least_samples=0.1),
        Parameter('K', 'stroke per command', '1', 0.5, 2.0, 1e-3, 1e3),
    ),
    constants=(),
    ports=(
        Port('command', 'command', '1', 'opening asked for'),
        Port('spring', 'balance', '1', 'opening asked for less the opening, which moves the stem'),
        Port('actuator', 'speed', '1/s', 'speed of the actuator', {'position': '1'}),
        Port('stem', 'stem', '1', 'opening of the valve'),
        Port('sensor', 'sensor', '1', 'opening as measured'),
    ),
    equations=equations,
    at_rest=(),
    finest=0.02,        # fifteen samples in the shortest lag of a positioner, 0.3 s
    start_up=1.0,                               # shows where the stem is, which is measured
    output_range=(0.0, 1.0),                    # shut to open
)
