"""A drive of which the speed is measured: an inertia with viscous friction, moved by a torque."""
from __future__ import annotations

from types import SimpleNamespace

from hydro_twin.plants.equations import Linear, Ports
from hydro_twin.plants.plant import Parameter, Plant, Port, Signal


def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Ports
              ) -> dict[str, Linear]:
    """Return the rate of J omega' + B omega = torque."""
    command = port('command', u.torque)
    torque = port('motor', command - p.B * x.omega, velocity=x.omega)
    port('sensor', x.omega)
    return {'omega': torque / p.J}


DRIVE = Plant(
    name='drive',
    title='drive',
    sample_time=0.001,
    inputs=(Signal('torque', 'torque of the drive', 'N m', held=True),),
    output=Signal('omega', 'speed', 'rad/s'),
    states=('omega',),
    parameters=(            # from a small motor to a vehicle
        Parameter('J', 'moment of inertia', 'kg m^2', 1e-8, 1e4, 1e-11, 1e7),
        Parameter('B', 'viscous friction', 'N m s/rad', 1e-8, 1e5, 1e-11, 1e8),
    ),
    constants=(),
    ports=(
        Port('command', 'command', 'N m', 'torque asked of the drive'),
        Port('motor', 'force', 'N m', 'torque on the inertia', {'velocity': 'rad/s'}),
        Port('sensor', 'sensor', 'rad/s', 'speed as measured'),
    ),
    equations=equations,
    at_rest=(),
    start_up=0.05,              # shows the speed, which is measured
)
