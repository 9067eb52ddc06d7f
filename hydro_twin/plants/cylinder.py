"""A hydraulic cylinder driven by a valve or a pump: a lag, a speed gain, an integrator."""
from __future__ import annotations

from types import SimpleNamespace

from hydro_twin.plants.equations import Linear, Ports
from hydro_twin.plants.plant import Parameter, Plant, Port, Signal


def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Ports
              ) -> dict[str, Linear]:
    """Return the rates of a lag, tau q' + q = command, and of x' = K_v q."""
    command = port('command', u.command)
    spool_rate = port('spool', (command - x.q) / p.tau)
    q = port('spool', x.q)
    speed = port('piston', p.K_v * q, opening=q, position=x.x)
    port('sensor', x.x)
    port.sensor('v', speed)
    return {'q': spool_rate, 'x': speed}


CYLINDER = Plant(
    name='cylinder',
    title='hydraulic cylinder',
    sample_time=0.002,
    inputs=(Signal('command', 'opening of the valve or speed of the pump', '1', held=True),),
    output=Signal('x', 'position of the piston', 'm'),
    sensors=(Signal('v', 'speed of the piston', 'm/s'),),
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
    equations=equations,
    at_rest=('q',),
    commanded=('q',),
    start_up=0.1,                               # three lags of a valve, some 30 ms
)
