"""How much of a rig's recording no linear load simulator explains, however tuned."""
from __future__ import annotations

from numba import njit
import numpy as np
from scipy.linalg import expm
from scipy.optimize import least_squares

from benchmarks.tracing.laws import Laws, SAMPLE_TIME
from benchmarks.tracing.rigs import BOX, Rig
from benchmarks.tracing.signals import FloatArray

# x_v, p_L, omega_j, theta_j in units that keep the matrices' entries of like size
UNITS = np.array([1e-5, 1e6, 1.0, 1e-2])
# V_m and beta_e count only as their ratio, K_q and K_sv as their product: one of each is free
FREE = ('V_m', 'J', 'K_p', 'K_q', 'G', 'K_ce', 'B_m')
REACH = np.log(30.0)


def shows(rig: Rig) -> float:
    """Return the relative rise of the best linear free run's error above the noise."""
    return best_linear_rms(rig) / rig.truth.noise_rms - 1.0


def best_linear_rms(rig: Rig) -> float:
    """Fit the linear laws' free run to all series, each from its best start [N m].

    From three starts: the rig's own parameters, the middle of the box and a point drawn in it.
    """
    box = np.log([BOX[name] for name in FREE])
    middle = box.mean(axis=1)
    drawn = np.random.default_rng(rig.seed).uniform(box[:, 0], box[:, 1])
    own = np.log([getattr(rig.truth.laws, name) for name in FREE])

    def error(log_free: FloatArray) -> FloatArray:
        laws = rig.truth.laws._replace(**dict(zip(FREE, np.exp(log_free), strict=True)))
        system = sampled(laws, rig.truth.interpolation == 'linear')
        return np.concatenate([_misfit(*system, laws.G, series) for series in rig.series])

    fits = [least_squares(error, start, bounds=(middle - REACH, middle + REACH), max_nfev=40)
            for start in (own, middle, drawn)]
    return float(np.sqrt(2.0 * min(fit.cost for fit in fits) / sum(map(len, rig.clean))))


def sampled(r: Laws, linear_command: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (F, B0, B1) with x(k+1) = F x(k) + B0 v(k) + B1 (v(k+1) - v(k)), v = (u, theta_d).

    Exact for an angle that is linear between samples, and a command that is held or linear.
    """
    c = 4.0 * r.beta_e / r.V_m
    a = np.array([
        [-1 / r.K_p, 0, 0, 0],
        [c * r.K_q, -c * r.K_ce, -c * r.D_m, 0],
        [0, r.D_m / r.J, -r.B_m / r.J, -r.G / r.J],
        [0, 0, 1, 0]])
    b = np.array([[r.K_sv / r.K_p, 0], [0, 0], [0, r.G / r.J], [0, 0]])
    block = np.zeros((8, 8))
    block[:4, :4] = a * UNITS / UNITS[:, None] * SAMPLE_TIME
    block[:4, 4:6] = b / UNITS[:, None] * SAMPLE_TIME
    block[4:6, 6:] = np.eye(2)
    whole = expm(block)
    held, ramp = whole[:4, 4:6], whole[:4, 6:].copy()
    if not linear_command:
        ramp[:, 0] = 0.0
    return whole[:4, :4].copy(), held, ramp


@njit(cache=True)
def _responses(F, B0, B1, u, angle):
    """Return theta_j driven from rest, then free from each state in turn: (n, 5)."""
    n = len(u)
    out = np.empty((n, 5))
    x = np.zeros((4, 5))
    x[:, 1:] = np.eye(4)
    for k in range(n):
        out[k] = x[3]
        nxt = k + 1 if k + 1 < n else k
        x = F @ x
        for i in range(4):
            x[i, 0] += (B0[i, 0] * u[k] + B0[i, 1] * angle[k]
                        + B1[i, 0] * (u[nxt] - u[k]) + B1[i, 1] * (angle[nxt] - angle[k]))
    return out


def _misfit(F: FloatArray, B0: FloatArray, B1: FloatArray, stiffness: float,
            series: dict[str, FloatArray]) -> FloatArray:
    responses = stiffness * UNITS[3] * _responses(F, B0, B1, series['u_m'], series['theta_d'])
    left = series['T_g'] + stiffness * series['theta_d'] - responses[:, 0]
    start = np.linalg.lstsq(responses[:, 1:], left, rcond=1e-10)[0]
    return responses[:, 1:] @ start - left
