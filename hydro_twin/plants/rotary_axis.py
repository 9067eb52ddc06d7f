"""A rotary axis: an inertia with viscous friction moved by a torque, as a joint or a drive."""
from __future__ import annotations

from types import SimpleNamespace

from hydro_twin.plants.equations import Linear, Ports
from hydro_twin.plants.plant import Parameter, Plant, Port, Signal


def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Ports
              ) -> dict[str, Linear]:
    """Return the rates of J theta'' + B theta' = torque."""
    command = port('command', u.torque)
    torque = port('motor', command - p.B * x.omega, velocity=x.omega, position=x.theta)
    port('sensor', x.theta)
    port.sensor('omega', x.omega)
    return {'omega': torque / p.J, 'theta': x.omega}


ROTARY_AXIS = Plant(
    name='rotary_axis',
    title='rotary axis',
    sample_time=0.001,
    inputs=(Signal('torque', 'torque of the drive', 'N m', held=True),),
    output=Signal('theta', 'angle', 'rad'),
    sensors=(Signal('omega', 'angular velocity', 'rad/s'),),
    states=('omega', 'theta'),
    parameters=(            # from the rotor of a small motor to the slewing ring of a crane
        Parameter('J', 'moment of inertia', 'kg m^2', 1e-8, 1e4, 1e-11, 1e7),
        Parameter('B', 'viscous friction', 'N m s/rad', 1e-8, 1e5, 1e-11, 1e8),
    ),
    constants=(),
    ports=(
        Port('command', 'command', 'N m', 'torque asked of the drive'),
        Port('motor', 'force', 'N m', 'torque on the inertia',
             {'velocity': 'rad/s', 'position': 'rad'}),
        Port('sensor', 'sensor', 'rad', 'angle as measured'),
    ),
    equations=equations,
    at_rest=('theta',),
    start_up=0.05,              # shows angle and velocity, which the axis does not forget
)
