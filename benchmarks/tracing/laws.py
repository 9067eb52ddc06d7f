"""The load simulator of [B19] with anything built in, integrated finely: the truth of a benchmark.

Written from the textbook and apart from hydro_twin, so that a mistake there is not repeated here:
classical Runge-Kutta at 25 us, against whatever the product's own step is.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit
import numpy as np

SAMPLE_TIME = 0.002
SUBSTEPS = 80
INF = math.inf


class Laws(NamedTuple):
    """The five laws' parameters, then what else the rig has; the defaults switch it off."""

    V_m: float
    J: float
    K_p: float
    K_q: float
    G: float
    K_ce: float
    B_m: float
    K_sv: float
    beta_e: float
    D_m: float = 2.0e-5
    # spool
    rate: float = INF              # limit of |x_v'| [m/s]
    rate_softness: float = 0.0     # 1: tanh instead of a corner
    stop: float = INF              # hard stop of the spool itself [m]
    play: float = 0.0              # half width of play between spool and opening [m]
    bouc_wen: float = 0.0          # largest hysteretic displacement [m]
    bouc_wen_power: float = 1.0
    # opening
    dead_low: float = 0.0          # overlap, each side [m]
    dead_high: float = 0.0
    dead_corner: float = 0.0       # width of a rounded corner [m]
    dead_slope: float = 0.0        # slope left inside the dead zone
    stroke: float = INF            # opening saturates [m]
    stroke_power: float = INF      # x / (1 + |x/s|^n)^(1/n); infinite: a clip
    # flow
    asymmetry: float = 0.0         # gain 1 + a for x > 0, 1 - a for x < 0
    asymmetry_width: float = 0.0   # the sign rounded over this opening [m]
    skew: float = 0.0              # x + skew x^2 [1/m]
    progressive: float = 0.0       # x (1 + progressive |x|) [1/m]
    flow_tanh: float = INF         # s tanh(x/s) [m]
    supply_high: float = INF       # orifice: supply pressure for x > 0, x < 0 [Pa]
    supply_low: float = INF
    orifice_power: float = 0.5
    flow_bias: float = 0.0         # [m^3/s]
    gain_drift: float = 0.0        # K_q (1 + drift sin(w t))
    gain_drift_rate: float = 0.0   # w [rad/s]
    # leakage and oil
    leak_root: float = 0.0         # c sgn(p) sqrt|p|
    leak_square: float = 0.0       # c p |p|
    relief: float = INF            # opens above this pressure [Pa]
    relief_slope: float = 0.0      # [m^5/(N s)]
    leak_drift: float = 0.0        # K_ce (1 + drift t) [1/s]
    air: float = 0.0               # rise of the compliance at p_L = 0
    air_pressure: float = 1.0      # ... gone well above this [Pa]
    gas: float = 0.0               # free gas in two chambers: beta_e alpha p_0 / mean^2
    mean_pressure: float = 1.0     # of the two chambers [Pa]
    # motor
    coulomb: float = 0.0           # true stick and slip [N m]
    static: float = 0.0            # breakaway torque [N m]
    stribeck: float = 1.0          # [rad/s]
    load_friction: float = 0.0     # friction per torque carried
    smooth_coulomb: float = 0.0    # F tanh(w / width) [N m]
    smooth_width: float = 1.0      # [rad/s]
    lugre: float = 0.0             # 1: coulomb, static, stribeck are a LuGre model's
    bristle: float = 1.0           # sigma_0 [N m/rad]
    bristle_damping: float = 0.0   # sigma_1 [N m s/rad]
    torque_bias: float = 0.0       # [N m]
    ripple: float = 0.0            # [N m]
    ripple_order: float = 0.0
    ripple_phase: float = 0.0
    drag: float = 0.0              # c w |w|
    pressure_damping: float = 0.0  # B_m (1 + c |p|) [1/Pa]
    # coupling
    gap: float = 0.0               # half width of the backlash [rad]
    gap_centre: float = 0.0
    gap_stiffness: float = 0.0     # [N m/rad] inside the gap
    contact_damping: float = 0.0   # [N m s/rad] outside it
    cubic: float = 0.0             # G f (1 + cubic f^2) [1/rad^2]
    quadratic: float = 0.0         # G f (1 + quadratic |f|) [1/rad]
    knee: float = INF              # beyond this twist [rad] ...
    knee_stiffness: float = 0.0    # ... this stiffness more [N m/rad]
    # sensor
    mode: float = 0.0              # natural frequency of a structural mode [rad/s]
    mode_damping: float = 0.0


@njit(cache=True)
def clip(value, low, high):
    return min(max(value, low), high)


@njit(cache=True)
def overlap(r, x):
    """Return the opening that an overlapped land leaves of the spool's position."""
    if r.dead_low == 0.0 and r.dead_high == 0.0:
        return x
    if r.dead_corner == 0.0:
        return x - (1.0 - r.dead_slope) * clip(x, -r.dead_low, r.dead_high)
    c = r.dead_corner
    return c * (_softplus((x - r.dead_high) / c) - _softplus((-x - r.dead_low) / c)
                - _softplus(-r.dead_high / c) + _softplus(-r.dead_low / c))


@njit(cache=True)
def _softplus(x):
    return max(x, 0.0) + math.log1p(math.exp(-abs(x)))


@njit(cache=True)
def saturated(r, x):
    """Return the opening as the end of the window limits it."""
    if r.stroke == math.inf:
        return x
    if r.stroke_power == math.inf:
        return clip(x, -r.stroke, r.stroke)
    return x / (1.0 + abs(x / r.stroke) ** r.stroke_power) ** (1.0 / r.stroke_power)


@njit(cache=True)
def flow(r, x, p, t):
    """Return the valve's flow at opening x, without the linear fall with pressure."""
    if r.flow_tanh < math.inf:
        x = r.flow_tanh * math.tanh(x / r.flow_tanh)
    side = math.copysign(1.0, x)
    if r.asymmetry_width > 0.0:
        side = math.tanh(x / r.asymmetry_width)
    gain = 1.0 + r.asymmetry * side + r.skew * x + r.progressive * abs(x)
    supply = r.supply_high if x > 0.0 else r.supply_low
    if supply < math.inf:
        drop = 1.0 - math.copysign(p, x * p) / supply
        gain *= math.copysign(abs(drop) ** r.orifice_power, drop)
    gain *= 1.0 + r.gain_drift * math.sin(r.gain_drift_rate * t)
    return r.K_q * gain * x + r.flow_bias


@njit(cache=True)
def leakage(r, p, t):
    """Return all that is lost with pressure: K_ce p_L and what is not laminar."""
    q = r.K_ce * (1.0 + r.leak_drift * t) * p
    if r.leak_root > 0.0:
        # laminar below 1 kPa, as every orifice is: sqrt has no slope at zero
        q += r.leak_root * p / math.sqrt(abs(p) + 1.0e3)
    q += r.leak_square * p * abs(p)
    if abs(p) > r.relief:
        q += r.relief_slope * math.copysign(abs(p) - r.relief, p)
    return q


@njit(cache=True)
def compliance(r, p):
    """Return V_m / (4 beta_e) with the free gas in the oil."""
    factor = 1.0 + r.air / (1.0 + (p / r.air_pressure) ** 2)
    if r.gas > 0.0:
        # isothermal gas, each chamber at mean +- p_L / 2, never below 5 % of the mean
        high = max(1.0 + 0.5 * p / r.mean_pressure, 0.05)
        low = max(1.0 - 0.5 * p / r.mean_pressure, 0.05)
        factor += 0.5 * r.gas * (1.0 / high**2 + 1.0 / low**2)
    return factor * r.V_m / (4.0 * r.beta_e)


@njit(cache=True)
def coupling(r, twist, twist_rate):
    """Return the torque of the shaft at a twist."""
    f = twist
    torque = 0.0
    if r.gap > 0.0:
        inside = clip(twist - r.gap_centre, -r.gap, r.gap)
        f = twist - r.gap_centre - inside
        torque = r.gap_stiffness * (inside + r.gap_centre)
        if f != 0.0:
            torque += r.contact_damping * twist_rate
    torque += r.G * f * (1.0 + r.cubic * f * f + r.quadratic * abs(f))
    if abs(f) > r.knee:
        torque += r.knee_stiffness * math.copysign(abs(f) - r.knee, f)
    return torque


@njit(cache=True)
def slip_torque(r, omega, torque):
    """Return the size of dry friction at a speed while carrying a torque."""
    stribeck = (r.static - r.coulomb) * math.exp(-(omega / r.stribeck) ** 2)
    return r.coulomb + stribeck + r.load_friction * abs(torque)


@njit(cache=True)
def driving_torque(r, p, theta, torque):
    """Return what turns the motor against friction."""
    ripple = r.ripple * math.sin(r.ripple_order * theta + r.ripple_phase)
    return r.D_m * p - torque - ripple - r.torque_bias


@njit(cache=True)
def rates(r, y, u, angle, angle_rate, t, way, play):
    """Return y' for y = (x_v, p_L, omega_j, theta_j, bristle, bouc_wen, sensor, sensor').

    way: +-1 while slipping that way, 0 while stuck, 2 where there is no stick and slip.
    """
    x, p, omega, theta, bristle, wen, sensed, sensed_rate = y
    dx = (r.K_sv * u - x) / r.K_p                                            # eq. 15
    if r.rate < math.inf:
        dx = r.rate * math.tanh(dx / r.rate) if r.rate_softness else clip(dx, -r.rate, r.rate)
    if abs(x) >= r.stop and dx * x > 0.0:
        dx = 0.0
    opening = x
    if r.play > 0.0:
        opening = clip(play, x - r.play, x + r.play)
    dwen = 0.0
    if r.bouc_wen > 0.0:
        grip = abs(wen / r.bouc_wen) ** r.bouc_wen_power
        dwen = dx * (1.0 - 0.5 * grip * (1.0 + math.copysign(1.0, dx * wen)))
        opening = x - wen
    opening = saturated(r, overlap(r, opening))
    dp = (flow(r, opening, p, t) - leakage(r, p, t) - r.D_m * omega) / compliance(r, p)  # 11, 12
    torque = coupling(r, theta - angle, omega - angle_rate)                  # eq. 14
    friction = r.B_m * (1.0 + r.pressure_damping * abs(p)) * omega + r.drag * omega * abs(omega)
    friction += r.smooth_coulomb * math.tanh(omega / r.smooth_width)
    dbristle = 0.0
    if r.lugre > 0.0:
        dbristle = omega - r.bristle * abs(omega) / slip_torque(r, omega, 0.0) * bristle
        friction += r.bristle * bristle + r.bristle_damping * dbristle
    elif abs(way) == 1.0:
        friction += way * slip_torque(r, omega, torque)
    domega = (driving_torque(r, p, theta, torque) - friction) / r.J          # eq. 13
    dtheta = omega
    if way == 0.0:
        domega = 0.0
        dtheta = 0.0
    dsensed_rate = r.mode * (r.mode * (torque - sensed) - 2.0 * r.mode_damping * sensed_rate)
    return dx, dp, domega, dtheta, dbristle, dwen, sensed_rate, dsensed_rate


@njit(cache=True)
def _along(y, k, h):
    return (y[0] + h * k[0], y[1] + h * k[1], y[2] + h * k[2], y[3] + h * k[3],
            y[4] + h * k[4], y[5] + h * k[5], y[6] + h * k[6], y[7] + h * k[7])


@njit(cache=True)
def _next_way(r, y, way, angle, angle_rate):
    """Return the way of slipping after a step: the motor stops where its speed changed sign."""
    torque = coupling(r, y[3] - angle, 0.0 - angle_rate)
    drive = driving_torque(r, y[1], y[3], torque)
    if way != 0.0 and y[2] * way > 0.0:
        return way
    if abs(drive) <= slip_torque(r, 0.0, torque):
        return 0.0
    return math.copysign(1.0, drive)


@njit(cache=True)
def integrate(r, u, angle, start_time, step, keep):
    """Integrate the laws from rest.

    Args:
        r: the rig.
        u: the command after whatever befalls it, one value a step.
        angle: theta_d at every half step, 2 len(u) + 1 values.
        start_time: time of the first value, for what drifts [s].
        step: step [s].
        keep: keep every keep-th state.

    Returns:
        (states, torques): (n, 8) and (n,) with n = len(u) // keep; the torque as sensed.
    """
    n = len(u) // keep
    states = np.empty((n, 8))
    torques = np.empty(n)
    y = (0.0, 0.0, 0.0, angle[0], 0.0, 0.0, 0.0, 0.0)
    dry = r.lugre == 0.0 and (r.coulomb > 0.0 or r.load_friction > 0.0)
    way = 0.0 if dry else 2.0
    play = 0.0
    half = 0.5 * step
    for i in range(n * keep):
        a1, a2, a3 = angle[2 * i], angle[2 * i + 1], angle[2 * i + 2]
        angle_rate = (a3 - a1) / step
        if i % keep == 0:
            states[i // keep] = y
            torque = coupling(r, y[3] - a1, y[2] - angle_rate)
            torques[i // keep] = torque if r.mode == 0.0 else y[6]
        t = start_time + i * step
        k1 = rates(r, y, u[i], a1, angle_rate, t, way, play)
        k2 = rates(r, _along(y, k1, half), u[i], a2, angle_rate, t + half, way, play)
        k3 = rates(r, _along(y, k2, half), u[i], a2, angle_rate, t + half, way, play)
        k4 = rates(r, _along(y, k3, step), u[i], a3, angle_rate, t + step, way, play)
        y = _along(_along(_along(_along(y, k1, step / 6), k2, step / 3), k3, step / 3),
                   k4, step / 6)
        if r.stop < math.inf:
            y = (clip(y[0], -r.stop, r.stop), y[1], y[2], y[3], y[4], y[5], y[6], y[7])
        if r.play > 0.0:
            play = clip(play, y[0] - r.play, y[0] + r.play)
        if dry:
            after = _next_way(r, y, way, a3, angle_rate)
            if after != way:
                y = (y[0], y[1], 0.0, y[3], y[4], y[5], y[6], y[7])
            way = after
    return states, torques
