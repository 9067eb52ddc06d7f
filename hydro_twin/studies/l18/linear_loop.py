"""The linear valve servo in discrete time, exactly, and back from its poles to its parameters.

Y/U = k_1 / (T_c T_y tau s^3 + T_c (T_y + tau) s^2 + T_c s + k_1)             [L18, linear part]
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import cont2discrete

from hydro_twin.errors import DataError
from hydro_twin.plants.valve_servo import VALVE_SERVO

HIDDEN = 0.1    # magnitude below which noise decides a pole's sign

ComplexArray = npt.NDArray[np.complex128]


class LoopParameters(NamedTuple):
    """Parameters of the linear loop [L18].

    The transfer function holds T_c and k_1 only as T_c / k_1, and is the same with T_y and tau
    exchanged: from command and opening, k_1 must be given, and T_y >= tau is a convention.

    Attributes:
        T_y: time constant of the electro-hydraulic converter [s].
        T_c: time constant of the actuator, an integrator [s].
        tau: lag of the actuator [s].
        k_1: correction coefficient [1].
    """

    T_y: float
    T_c: float
    tau: float
    k_1: float


PUBLISHED = LoopParameters(T_y=0.0203, T_c=0.294, tau=0.00293, k_1=1.093)  # [L18, Table 2]


class Weights(NamedTuple):
    """A difference equation y(k) = sum_i v_i u(k-i) + sum_i n_i y(k-i), i from 1 [1].

    Attributes:
        v: weights of the past commands.
        n: weights of the past openings, n_1 to n_3.
    """

    v: tuple[float, ...]
    n: tuple[float, float, float]

    def gain(self) -> float:
        """Return the steady gain; unit feedback makes it 1."""
        return sum(self.v) / (1 - sum(self.n))

    def poles(self) -> ComplexArray:
        """Return the three poles in z, largest magnitude first."""
        poles = np.roots([1.0, *(-weight for weight in self.n)]).astype(complex)
        return poles[np.argsort(-np.abs(poles))]


def exact_equivalent(T_y: float, T_c: float, tau: float, k_1: float, T: float) -> Weights:
    """Discretise the linear loop exactly for a command held over each sample.

    Args:
        T_y: time constant of the converter [s], > 0.
        T_c: time constant of the actuator [s], > 0.
        tau: lag [s], > 0.
        k_1: correction coefficient [1], > 0.
        T: sample time [s], > 0.

    Returns:
        Three weights of the command, three of the opening.
    """
    loop = VALVE_SERVO.laws({'T_y': T_y, 'T_c': T_c, 'tau': tau, 'k_1': k_1})
    F, H, C, _, _ = cont2discrete((loop.A, loop.B, loop.C, loop.D), dt=T)
    n = -np.poly(F)[1:]
    # The first three samples of the pulse response c F^(i-1) H give the command's weights.
    pulse = [(C @ np.linalg.matrix_power(F, i) @ H).item() for i in range(3)]
    n1, n2, n3 = n.tolist()
    v = (pulse[0], pulse[1] - n1 * pulse[0], pulse[2] - n1 * pulse[1] - n2 * pulse[0])
    return Weights(v, (n1, n2, n3))


def parameters_from_poles(weights: Weights, T: float, k_1: float) -> LoopParameters:
    """Read the parameters back from the poles of a difference equation, exactly.

    The closed loop is 1 / prod(1 + t_i s) with t_i = -T / ln z_i, so that sum t_i = T_c / k_1,
    sum t_i t_j = (T_c / k_1) (T_y + tau) and prod t_i = (T_c / k_1) T_y tau.

    A fastest pole too small to be distinguished from none, |z| < 0.1, that is not positive gives
    no tau: the lag is then faster than the sampling shows, and tau is nan.

    Args:
        weights: the difference equation.
        T: its sample time [s].
        k_1: correction coefficient [1]; only T_c / k_1 is identifiable.

    Raises:
        DataError: no loop of this structure has these poles: one is not stable, is real and not
            positive (a sampled time constant never is), or T_y and tau come out complex.
    """
    z = weights.poles()
    shown = ', '.join(f'{pole.real:.5g}{f"{pole.imag:+.5g}j" if pole.imag else ""}' for pole in z)
    if np.any(np.abs(z) >= 1):
        raise DataError(f'the weights read back exactly are not stable: poles {shown}')
    hidden = z[2].imag == 0 and -HIDDEN < z[2].real <= 0
    visible = z[:2] if hidden else z
    if np.any((visible.imag == 0) & (visible.real <= 0)):
        raise DataError(
            f'the weights are of no sampled servo: poles {shown}, a real one must be positive')
    t = np.concatenate([-T / np.log(visible), np.zeros(3 - len(visible))])
    ratio = t.sum().real                                         # T_c / k_1
    lags = (t[0] * t[1] + t[0] * t[2] + t[1] * t[2]).real / ratio    # T_y + tau
    product = t.prod().real / ratio                              # T_y tau
    if lags**2 < 4 * product or ratio <= 0 or lags <= 0:
        raise DataError(f'the weights give no real positive T_y and tau: poles {shown}')
    root = float(np.sqrt(lags**2 - 4 * product))
    tau = float('nan') if hidden else (lags - root) / 2
    return LoopParameters(float(lags + root) / 2, float(ratio) * k_1, float(tau), k_1)
