"""The difference equation of a plant's linear laws, eq. 1 of [B19] for any of the plants."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from hydro_twin.plants.plant import FloatArray, Laws


@dataclass(frozen=True)
class DifferenceEquation:
    """y(k) = -a[0] y(k-1) - ... - a[n-1] y(k-n) + sum_j b[j] . u(k-j), j = 0..n.

    Attributes:
        a: shape (n,).
        b: shape (n + 1, m), a row for each lag.
    """

    a: FloatArray
    b: FloatArray


def from_state_space(Phi: FloatArray, Gamma: FloatArray, C: FloatArray,
                     D: FloatArray) -> DifferenceEquation:
    """Eliminate the states of x(k+1) = Phi x + Gamma u, y = C x + D u."""
    n = len(Phi)
    a = np.real(np.poly(np.linalg.eigvals(Phi)))
    markov = [D[0]]
    x = Gamma
    for _ in range(n):
        markov.append((C @ x)[0])
        x = Phi @ x
    b = np.array([sum(a[i] * markov[j - i] for i in range(j + 1)) for j in range(n + 1)])
    return DifferenceEquation(a[1:], b)


def bilinear(laws: Laws, sample_time: float) -> DifferenceEquation:
    """Apply the bilinear transform s = (2/T)(1 - z^-1)/(1 + z^-1), as eq. 1 of [B19]."""
    n = len(laws.A)
    half = 0.5 * sample_time * laws.A
    inverse = np.linalg.inv(np.eye(n) - half)
    Phi = inverse @ (np.eye(n) + half)
    Gamma = sample_time * inverse @ inverse @ laws.B
    return from_state_space(
        Phi, Gamma, laws.C, laws.D + 0.5 * sample_time * laws.C @ inverse @ laws.B)


def characteristic(laws: Laws, sample_time: float) -> FloatArray:
    """Coefficients a of the exact discrete system, without its leading 1; shape (n,)."""
    poles = np.linalg.eigvals(expm(laws.A * sample_time))
    return np.real(np.poly(poles))[1:]
