"""The torque load simulator of [B19]: a hydraulic motor that loads a moving shaft."""
from __future__ import annotations

from types import SimpleNamespace

from hydro_twin.plants.equations import Linear, Ports
from hydro_twin.plants.load_simulator_eq1 import coefficients
from hydro_twin.plants.plant import Constant, Parameter, Plant, Port, Signal


def equations(p: SimpleNamespace, x: SimpleNamespace, u: SimpleNamespace, port: Ports
              ) -> dict[str, Linear]:
    """Return the rates by the five laws of the load simulator, [B19] eqs 11 to 15."""
    u_m = port('command', u.u_m)
    spool_rate = port('spool', (p.K_sv * u_m - x.x_v) / p.K_p)                  # eq. 15
    x_v = port('spool', x.x_v)
    p_L = port('chamber', x.p_L, load_pressure=x.p_L)
    Q_L = port('flow', p.K_q * x_v, opening=x_v, load_pressure=p_L)             # eq. 11, K_c below
    leakage = port('leakage', p.K_ce * p_L, load_pressure=p_L)                  # K_ce = K_c + C_tm
    torque = port('motor', p.D_m * p_L - p.B_m * x.omega_j,
                  velocity=x.omega_j, position=x.theta_j)
    twist = x.theta_j - u.theta_d
    T_g = port('coupling', p.G * twist, twist=twist)                            # eq. 14
    port('sensor', T_g)
    port.sensor('p_L', p_L)
    port.sensor('x_v', x.x_v)
    port.sensor('theta_m', x.theta_j)
    port.sensor('omega_m', x.omega_j)
    net_flow = Q_L - leakage - p.D_m * x.omega_j
    return {
        'x_v': spool_rate,
        'p_L': 4.0 * p.beta_e / p.V_m * net_flow,                               # eq. 12
        'omega_j': (torque - T_g) / p.J,                                        # eq. 13
        'theta_j': x.omega_j,
    }


LOAD_SIMULATOR = Plant(
    name='load_simulator',
    title='torque load simulator',
    sample_time=0.002,
    inputs=(
        Signal('u_m', 'command to the load valve', 'V', held=True),
        Signal('theta_d', 'angle of the loaded shaft', 'rad'),
    ),
    output=Signal('T_g', 'torque on the shaft', 'N m'),
    sensors=(
        Signal('p_L', 'load pressure', 'Pa'),
        Signal('x_v', 'position of the spool', 'm'),
        Signal('theta_m', 'angle of the motor', 'rad'),
        Signal('omega_m', 'speed of the motor', 'rad/s'),
    ),
    states=('x_v', 'p_L', 'omega_j', 'theta_j'),
    parameters=(                                                # box: [B19] Table 1
        Parameter('V_m', 'total chamber volume', 'm^3', 1.6e-4, 1.9e-4, 1e-6, 1e-2),
        Parameter('J', 'equivalent inertia', 'kg m^2', 1e-2, 1e-1, 1e-5, 1e2),
        Parameter('K_p', 'valve time constant', 's', 5e-3, 3e-2, 1e-5, 1.0),
        Parameter('K_q', 'valve flow gain', 'm^2/s', 0.2, 2.5, 1e-3, 1e2),
        Parameter('G', 'coupling stiffness', 'N m/rad', 7e3, 1.5e4, 1e1, 1e7),
        Parameter('K_ce', 'flow-pressure coefficient', 'm^5/(N s)', 1e-12, 1e-11, 1e-15, 1e-8),
        Parameter('B_m', 'viscous damping', 'N m s/rad', 10.0, 100.0, 1e-3, 1e5),
        Parameter('K_sv', 'valve input gain', 'm/V', 3e-5, 2e-4, 1e-8, 1e-1),
        Parameter('beta_e', 'effective bulk modulus', 'Pa', 6.5e8, 7.5e8, 1e6, 1e10),
    ),
    constants=(Constant('D_m', 'motor displacement, from its data sheet', 'm^3/rad', 2.0e-5),),
    ports=(
        Port('command', 'command', 'V', 'command before the spool'),
        Port('spool', 'rate', 'm/s', 'speed of the spool'),
        Port('spool', 'opening', 'm', 'opening seen by the flow'),
        Port('chamber', 'pressure', 'Pa', 'load pressure that the oil between the valve and the '
             'motor gives', {'load_pressure': 'Pa'}),
        Port('flow', 'flow', 'm^3/s', 'flow through the valve without load',
             {'opening': 'm', 'load_pressure': 'Pa'}),
        Port('leakage', 'leakage', 'm^3/s', 'flow lost to load pressure', {'load_pressure': 'Pa'}),
        Port('motor', 'force', 'N m', 'torque on the inertia before the coupling',
             {'velocity': 'rad/s', 'position': 'rad'}),
        Port('coupling', 'coupling', 'N m', 'torque from twist', {'twist': 'rad'}),
        Port('sensor', 'sensor', 'N m', 'torque as measured'),
    ),
    equations=equations,
    at_rest=('x_v', 'omega_j', 'theta_j'),
    commanded=('x_v',),
    start_up=0.1,               # some time constants of spool, pressure and inertia, up to 20 ms
    combinations=({'V_m': 1, 'beta_e': -1}, {'K_q': 1, 'K_sv': 1}),
    output_scale=200.0,                                         # [B19]: T_g / 200
    closed_form=coefficients,
)
