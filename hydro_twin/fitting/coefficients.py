"""The coefficients of a plant's difference equation, for whole populations of parameters."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_twin.fitting.one_step import Coefficients
from hydro_twin.plants import Plant
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.plants.load_simulator_eq1 import coefficients as eq1


def coefficients_of(
    plant: Plant, constants: Mapping[str, float], sample_time: float,
) -> Coefficients:
    """Return the map from parameters to the coefficients of y(k-1..k-n) and u(k..k-n).

    Args:
        plant: the load simulator has a closed form, [B19] eqs 21 to 24; any other plant goes
            through the bilinear transform of its laws.
        constants: of the rig, by name.
        sample_time: T [s].
    """
    if plant.name == LOAD_SIMULATOR.name:
        return lambda population: eq1(population, constants['D_m'], sample_time)
    names = [p.name for p in plant.parameters]

    def general(population: npt.NDArray[Any]) -> npt.NDArray[Any]:
        laws = [plant.laws({**constants, **dict(zip(names, row, strict=True))})
                for row in population]
        A, B, C, D = (np.array([getattr(law, matrix) for law in laws]) for matrix in 'ABCD')
        return bilinear(A, B, C, D, sample_time)

    return general


def bilinear(
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
