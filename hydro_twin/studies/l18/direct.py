"""Bounded least squares straight on T_y, T_c and tau, by the free run or by one step."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.fitting.identifiability import assess
from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import parts_of
from hydro_twin.model import Estimate
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.recording.series import Recording
from hydro_twin.studies.l18.linear_loop import exact_equivalent, LoopParameters

NAMES = ('T_y', 'T_c', 'tau')
ORDER = 3
EDGE = 1e-3         # logarithmic distance from an edge of the box that counts as on it: 0.1 %


def fit_free_run(recording: Recording, k_1: float) -> dict[str, Estimate]:
    """Fit by the error of the free run.

    Args:
        recording: with the signals command and opening.
        k_1: correction coefficient [1]; only T_c / k_1 is identifiable.

    Returns:
        T_y, T_c and tau [s]; T_c is that which belongs to this k_1.

    Raises:
        DataError: no series is long enough, or the opening never moves.
    """
    parts = parts_of(recording, VALVE_SERVO)
    fit = fit_linear(VALVE_SERVO, parts, {}, recording.series[0].sample_time)
    values, known = fit.candidate.values, fit.identifiability()
    found = {'T_y': values['T_y'], 'T_c': values['T_c'] / values['k_1'] * k_1,
             'tau': values['tau']}
    return _estimates(found, {**known.std_error, 'T_c': known.combinations['T_c/k_1']})


def fit_one_step(recording: Recording, k_1: float) -> dict[str, Estimate]:
    """Fit by the one-step error of the exact difference equation.

    Noise of the sensor is in the regressors too, and biases the result; its standard errors do
    not show that.

    Args:
        recording: with the signals command and opening.
        k_1: correction coefficient [1].

    Returns:
        T_y, T_c and tau [s]; T_c is that which belongs to this k_1.

    Raises:
        DataError: no series has more than a few samples, or the command never moves.
    """
    rows, targets = [], []
    for series in recording.series:
        u, y, k = series['command'], series['opening'], np.arange(ORDER, len(series))
        rows.append(np.column_stack([s[k - lag] for s in (u, y) for lag in range(1, ORDER + 1)]))
        targets.append(y[k])
    X, y = np.concatenate(rows), np.concatenate(targets)
    if len(X) < 2 * X.shape[1] or np.ptp(X[:, 0]) == 0:
        raise DataError('the recording is too short, or its command never moves')
    found = nearest_loop(X, y, recording.series[0].sample_time, k_1)
    known = assess([(found.jacobian, found.residual)], NAMES, at_bound=found.at_edge)
    return _estimates(found.parameters._asdict(), known.std_error)


@dataclass(frozen=True)
class Nearest:
    """The linear loop that comes nearest to given predictions, in one step.

    Attributes:
        parameters: of the loop; T_c is that which belongs to the k_1 given.
        at_edge: those of T_y, T_c and tau that stopped at the edge of the search box.
        residual: what is left [1], shape (samples,).
        jacobian: its derivative by the logarithms of T_y, T_c and tau, shape (samples, 3).
    """

    parameters: LoopParameters
    at_edge: tuple[str, ...]
    residual: FloatArray
    jacobian: FloatArray


def nearest_loop(past: FloatArray, target: FloatArray, T: float, k_1: float) -> Nearest:
    """Find the loop whose exact difference equation predicts a target best, in the search box.

    Args:
        past: u(k-1) to u(k-3) and y(k-1) to y(k-3), shape (samples, 6).
        target: of the prediction, shape (samples,).
        T: sample time [s].
        k_1: correction coefficient [1]; T_c / k_1 may be anywhere in its box.
    """
    box = {p.name: (p.lower, p.upper) for p in VALVE_SERVO.parameters}
    lower, upper = np.log([box[name] for name in NAMES]).T
    ratios = np.log(np.array(box['k_1'])[::-1] / k_1)
    lower[1], upper[1] = lower[1] - ratios[0], upper[1] - ratios[1]

    def residual(x: FloatArray) -> FloatArray:
        T_y, T_c, tau = np.exp(x)
        v, n = exact_equivalent(T_y, T_c, tau, k_1, T)
        return np.asarray(past @ [*v, *n] - target)

    fit = least_squares(residual, (lower + upper) / 2, bounds=(lower, upper), xtol=1e-12,
                        ftol=1e-12, gtol=1e-15)
    T_y, T_c, tau = np.exp(fit.x).tolist()
    return Nearest(
        LoopParameters(T_y, T_c, tau, k_1),
        tuple(name for name, x, low, high in zip(NAMES, fit.x, lower, upper, strict=True)
              if min(x - low, high - x) < EDGE),
        np.asarray(fit.fun), np.asarray(fit.jac))


def _estimates(values: Mapping[str, float], relative: Mapping[str, float | None]
               ) -> dict[str, Estimate]:
    """Put values and relative standard errors together; None: the data do not determine it."""
    errors = {name: relative[name] for name in NAMES}
    return {name: Estimate(values[name], identifiable=error is not None,
                           std_error=None if error is None else values[name] * error)
            for name, error in errors.items()}
