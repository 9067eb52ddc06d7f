"""Bounded least squares straight on T_y, T_c and tau, by the free run or by one step."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import least_squares

from hydro_twin.errors import DataError
from hydro_twin.fitting.candidate import parts_of
from hydro_twin.fitting.free_run import fit_linear
from hydro_twin.fitting.identifiability import assess
from hydro_twin.model import Estimate
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.recording.series import FloatArray, Recording
from hydro_twin.valve.linear_loop import exact_equivalent

NAMES = ('T_y', 'T_c', 'tau')
ORDER = 3


def fit_free_run(recording: Recording, k_1: float) -> dict[str, Estimate]:
    """Fit by the error of the free run.

    Args:
        recording: with the signals command and opening.
        k_1: correction coefficient [1]; only T_c / k_1 can be told.

    Returns:
        T_y, T_c and tau [s]; T_c is that which belongs to this k_1.

    Raises:
        DataError: no series is long enough, or the opening never moves.
    """
    parts = parts_of(recording, VALVE_SERVO)
    fit = fit_linear(VALVE_SERVO, parts, {}, recording.series[0].sample_time, 'box', timing=False)
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
    box = {p.name: (p.lower, p.upper) for p in VALVE_SERVO.parameters}
    lower, upper = np.log([box[name] for name in NAMES]).T
    ratios = np.log(np.array(box['k_1'])[::-1] / k_1)       # k_1 may be anywhere in its box too
    lower[1], upper[1] = lower[1] - ratios[0], upper[1] - ratios[1]

    def residual(x: FloatArray) -> FloatArray:
        T_y, T_c, tau = np.exp(x)
        v, n = exact_equivalent(T_y, T_c, tau, k_1, recording.series[0].sample_time)
        return np.asarray(X @ [*v, *n] - y)

    fit = least_squares(residual, (lower + upper) / 2, bounds=(lower, upper), xtol=1e-12,
                        ftol=1e-12, gtol=1e-15)
    edge = [name for name, active in zip(NAMES, fit.active_mask, strict=True) if active]
    known = assess([(np.asarray(fit.jac), fit.fun)], NAMES, at_bound=edge)
    return _estimates(dict(zip(NAMES, np.exp(fit.x).tolist(), strict=True)), known.std_error)


def _estimates(values: Mapping[str, float], relative: Mapping[str, float | None]
               ) -> dict[str, Estimate]:
    """Put values and relative standard errors together; None: the data do not tell it."""
    errors = {name: relative[name] for name in values}
    return {name: Estimate(value, None if (error := errors[name]) is None else value * error,
                           errors[name] is not None)
            for name, value in values.items()}
