"""Eq. 3 of [L18] as printed, both ways: it reproduces the paper's tables, and is not the servo.

The terms in T_y T_c tau lack a factor 1/T, so that the equation is dimensionally wrong; for
anything but the tables use `linear_loop.exact_equivalent`.
"""
from __future__ import annotations

from math import sqrt

from hydro_twin.errors import DataError
from hydro_twin.studies.l18.linear_loop import LoopParameters, Weights


def printed_weights(T_y: float, T_c: float, tau: float, k_1: float, T: float) -> Weights:
    """Compute the five weights of the printed difference equation [L18, eq. 3].

    Args:
        T_y: time constant of the converter [s].
        T_c: time constant of the actuator [s].
        tau: lag [s].
        k_1: correction coefficient [1].
        T: sample time [s].

    Returns:
        Two equal weights of the command, three of the opening.
    """
    third = T_y * T_c * tau                # stands where third / T should
    second = T_y * T_c + T_c * tau
    N = 2 * third + 2 * second
    v = k_1 * T**2 / N
    n1 = -(k_1 * T**2 + 2 * T_c * T - 6 * third - 4 * second) / N
    n2 = -(k_1 * T**2 + 6 * third + 2 * second - 2 * T_c * T) / N
    n3 = 2 * third / N
    return Weights((v, v), (n1, n2, n3))


def parameters_as_printed(weights: Weights, T: float, k_1: float) -> LoopParameters:
    """Solve the printed difference equation for the parameters.

    With v the mean of v_1 and v_2 and r = 2 T_c T / N, eq. 3 gives r twice,
    r = 2 + n_3 - v - n_1 = 1 + 2 n_3 + v + n_2 (the same where the steady gain is 1; the mean is
    taken), then T_y tau = n_3 T / r, T_y + tau = (1 - n_3) T / r and T_c = r k_1 T / (2 v).

    Args:
        weights: two weights of the command, three of the opening.
        T: sample time [s].
        k_1: correction coefficient [1]; only T_c / k_1 is identifiable.

    Raises:
        DataError: no real positive parameters give these weights.
    """
    v = sum(weights.v) / 2
    n1, n2, n3 = weights.n
    r = (3 + 3 * n3 - n1 + n2) / 2
    discriminant = ((1 - n3) * T)**2 - 4 * n3 * T * r      # times r^2
    if r <= 0 or v <= 0 or n3 <= 0 or discriminant < 0:
        raise DataError(
            'eq. 3 as printed has no real positive T_y, T_c and tau for the weights '
            f'v {v:.4g}, n {n1:.5g}, {n2:.5g}, {n3:.4g}')
    root = sqrt(discriminant)
    T_y, tau = ((1 - n3) * T + root) / (2 * r), ((1 - n3) * T - root) / (2 * r)
    return LoopParameters(T_y, r * k_1 * T / (2 * v), tau, k_1)
