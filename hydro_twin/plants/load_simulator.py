"""The torque load simulator of [B19]: a hydraulic motor that loads a moving shaft."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_twin.plants.plant import Constant, Laws, Parameter, Plant, Port, Signal


def laws(p: Mapping[str, float]) -> Laws:
    """State-space form of the five laws, [B19] eqs 11 to 15.

    States: x_v [m], p_L [Pa], omega_j [rad/s], theta_j [rad]; inputs: u_m [V], theta_d [rad].
    """
    stiffness = 4.0 * p['beta_e'] / p['V_m']                    # p_L' per net flow, eq. 12
    K_p, K_sv, K_q, K_ce = p['K_p'], p['K_sv'], p['K_q'], p['K_ce']
    J, B_m, G, D_m = p['J'], p['B_m'], p['G'], p['D_m']
    A = np.array([
        [-1.0 / K_p, 0.0, 0.0, 0.0],                            # eq. 15
        [stiffness * K_q, -stiffness * K_ce, -stiffness * D_m, 0.0],    # eqs 11, 12
        [0.0, D_m / J, -B_m / J, -G / J],                       # eqs 13, 14
        [0.0, 0.0, 1.0, 0.0],
    ])
    B = np.array([[K_sv / K_p, 0.0], [0.0, 0.0], [0.0, G / J], [0.0, 0.0]])
    #             command     rate     spool             chamber      flow     leakage   motor
    E = np.array([                                      # coupling, sensor
        [K_sv / K_p, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, stiffness * K_q, -stiffness * K_ce, stiffness, -stiffness, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, D_m / J, 0.0, 0.0, 1.0 / J, -1.0 / J, 0.0],
        [0.0] * 9,
    ])
    port_x = np.array([
        [0.0, 0.0, 0.0, 0.0],               # command: u_m
        [-1.0 / K_p, 0.0, 0.0, 0.0],        # spool rate: x_v'
        [1.0, 0.0, 0.0, 0.0],               # spool: x_v
        [0.0, 1.0, 0.0, 0.0],               # chamber: p_L
        [K_q, 0.0, 0.0, 0.0],               # flow: K_q x_v
        [0.0, K_ce, 0.0, 0.0],              # leakage: K_ce p_L
        [0.0, D_m, -B_m, 0.0],              # motor: D_m p_L - B_m omega_j
        [0.0, 0.0, 0.0, G],                 # coupling: G (theta_j - theta_d)
        [0.0, 0.0, 0.0, G],                 # sensor: T_g
    ])
    port_u = np.zeros((9, 2))
    port_u[0, 0] = 1.0
    port_u[1, 0] = K_sv / K_p
    port_u[7:, 1] = -G
    port_d = np.zeros((9, 9))
    port_d[1, 0] = K_sv / K_p
    port_d[4, 2] = K_q
    port_d[5:7, 3] = K_ce, D_m
    port_d[8, 7] = 1.0
    # load_pressure at chamber; opening, load_pressure at flow; load_pressure at leakage;
    # velocity, position at motor; twist at coupling
    signal_x = np.array([
        [0.0, 1.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 0.0, 1.0],
    ])
    signal_u = np.zeros((7, 2))
    signal_u[6, 1] = -1.0
    signal_d = np.zeros((7, 9))
    signal_d[1, 2] = 1.0
    signal_d[2:4, 3] = 1.0
    return Laws(A, B, E, port_x, port_u, port_d, signal_x, signal_u, signal_d)


LOAD_SIMULATOR = Plant(
    name='load_simulator',
    title='torque load simulator',
    sample_time=0.002,
    inputs=(
        Signal('u_m', 'command to the load valve', 'V', held=True),
        Signal('theta_d', 'angle of the load-bearing shaft', 'rad'),
    ),
    output=Signal('T_g', 'torque on the shaft', 'N m'),
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
    laws=laws,
    at_rest=('x_v', 'omega_j', 'theta_j'),
    start_up=0.1,               # some time constants of spool, pressure and inertia, up to 20 ms
    combinations=({'V_m': 1, 'beta_e': -1}, {'K_q': 1, 'K_sv': 1}),
    output_scale=200.0,                                         # [B19]: T_g / 200
)
