"""A positioning axis: a mass with viscous friction moved by a force."""
from __future__ import annotations

from types import SimpleNamespace

from hydro_twin.plants.equations import Linear, Ports
from hydro_twin.plants.plant import Parameter, Plant, Port, Signal


def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Ports
              ) -> dict[str, Linear]:
    """Return the rates of M x'' + F_v x' = force."""
    command = port('command', u.force)
    force = port('motor', command - p.F_v * x.v, velocity=x.v, position=x.x)
    port('sensor', x.x)
    port.sensor('v', x.v)
    return {'v': force / p.M, 'x': x.v}


POSITIONING = Plant(
    name='positioning',
    title='positioning axis',
    sample_time=0.001,
    inputs=(Signal('force', 'force of the drive', 'N', held=True),),
    output=Signal('x', 'position', 'm'),
    sensors=(Signal('v', 'velocity', 'm/s'),),
    states=('v', 'x'),
    parameters=(            # from the rotor of a small motor to a press; its middle is 1 kg
        Parameter('M', 'moving mass', 'kg', 1e-6, 1e6, 1e-9, 1e9),
        Parameter('F_v', 'viscous friction', 'N s/m', 1e-6, 1e7, 1e-9, 1e10),
    ),
    constants=(),
    ports=(
        Port('command', 'command', 'N', 'force asked of the drive'),
        Port('motor', 'force', 'N', 'force on the mass', {'velocity': 'm/s', 'position': 'm'}),
        Port('sensor', 'sensor', 'm', 'position as measured'),
    ),
    equations=equations,
    at_rest=('x',),
    start_up=0.05,              # shows position and velocity of the mass, which it does not forget
)
