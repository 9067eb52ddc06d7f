"""The difference equation of a plant's linear laws, eq. 1 of [B19] for any of the plants."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray
from hydro_twin.plants.plant import Laws


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
    n, m = laws.B.shape
    row = bilinear_coefficients(laws.A[None], laws.B[None], laws.C[None], laws.D[None],
                                sample_time)[0]
    return DifferenceEquation(-row[:n], row[n:].reshape(m, n + 1).T.copy())


def bilinear_coefficients(
    A: npt.NDArray[Any], B: npt.NDArray[Any], C: npt.NDArray[Any], D: npt.NDArray[Any], T: float,
) -> npt.NDArray[Any]:
    """Discretise systems by s = (2/T)(1 - z^-1)/(1 + z^-1), and eliminate their states.

    Only sums, products and inverses, so that complex parameters give derivatives by the complex
    step.

    Args:
        A: shape (P, n, n).
        B: shape (P, n, m).
        C: shape (P, 1, n).
        D: shape (P, 1, m).
        T: sample time [s].

    Returns:
        Shape (P, n + (n + 1) m): of y(k-1..k-n), then of u(k..k-n) of every input.
    """
    n = A.shape[1]
    identity = np.eye(n)
    inverse = np.linalg.inv(identity - 0.5 * T * A)
    Phi = inverse @ (identity + 0.5 * T * A)
    Gamma = T * inverse @ inverse @ B
    a = [np.ones(len(A))]                       # characteristic polynomial, Faddeev-LeVerrier
    M = np.zeros_like(Phi)
    for i in range(1, n + 1):
        M = Phi @ M + a[-1][:, None, None] * identity
        a.append(-np.trace(Phi @ M, axis1=1, axis2=2) / i)
    response = [D[:, 0] + 0.5 * T * (C @ inverse @ B)[:, 0]]
    for _ in range(n):
        response.append((C @ Gamma)[:, 0])
        Gamma = Phi @ Gamma
    b = [sum(a[i][:, None] * response[j - i] for i in range(j + 1)) for j in range(n + 1)]
    return np.concatenate(
        [-np.stack(a[1:], axis=1), np.stack(b, axis=2).reshape(len(A), -1)], axis=1)
