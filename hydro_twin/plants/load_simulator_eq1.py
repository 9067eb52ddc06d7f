"""The difference equation of the load simulator, for whole populations of parameters at once."""
from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

ORDER = 4


@cache
def powers_of_s(order: int, sample_time: float) -> npt.NDArray[np.float64]:
    """Powers of s under the bilinear transform s = (2/T) (1 - q) / (1 + q), q = z^-1.

    Returns:
        Shape (order + 1, order + 1): row i holds the coefficients of q^0 ... q^order in
        s^(order - i) (1 + q)^order.
    """
    rows = []
    for i in range(order + 1):
        row = np.ones(1)
        for _ in range(order - i):
            row = np.convolve(row, [1.0, -1.0])
        for _ in range(i):
            row = np.convolve(row, [1.0, 1.0])
        rows.append((2.0 / sample_time) ** (order - i) * row)
    return np.array(rows)


def coefficients(
    parameters: npt.NDArray[Any], constants: Mapping[str, float], sample_time: float,
) -> npt.NDArray[Any]:
    """Evaluate the coefficients of eq. 1 in closed form, [B19] eqs 21 to 24.

    They multiply T_g(k-1..k-4), u_m(k..k-4) and theta_d(k..k-4), in this order, so that
    T_g(k) is their scalar product with the regressors. Complex parameters are allowed, which
    gives derivatives by the complex step.

    Args:
        parameters: shape (P, 9), the columns V_m, J, K_p, K_q, G, K_ce, B_m, K_sv, beta_e
            of [B19] Table 1, in SI units.
        constants: D_m, the motor displacement [m^3/rad].
        sample_time: T [s].

    Returns:
        Shape (P, 14): -f1, f2, f3, -f4; d0 (1, 4, 6, 4, 1); -e0, -e1, e2, e3, -e4.
    """
    V_m, J, K_p, K_q, G, K_ce, B_m, K_sv, beta_e = np.asarray(parameters).T
    D_m = constants['D_m']
    c = V_m / (4.0 * beta_e)                                    # compliance of the oil
    den = D_m * K_q
    inertia = K_p * D_m**2 + K_ce * (K_p * B_m + J) + c * B_m
    damping = D_m**2 + K_ce * B_m
    b = np.array([                                              # den times G a1, G a2, b1, b2
        c * J * K_p,
        K_p * K_ce * J + c * (K_p * B_m + J),
        inertia,
        damping,
        np.zeros_like(den),
    ])
    a = np.array([                                              # den G times a1 ... a5, eq. 21
        b[0],
        b[1],
        inertia + c * K_p * G,
        damping + G * K_p * K_ce + c * G,
        G * K_ce,
    ])
    B = powers_of_s(ORDER, sample_time)
    f = B.T @ a                                                 # den G times f0 ... f4, signed
    out = np.empty((14, den.size), f.dtype)
    out[:4] = -f[1:] / f[0]                                     # eq. 22
    out[4:9] = (den * G * K_sv / f[0]) * B[-1][:, None]         # eq. 23
    out[9:] = -(G / f[0]) * (B.T @ b)                           # eq. 24
    return out.T
