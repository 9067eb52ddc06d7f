"""Primary frequency control in closed loop: power PID, valve servo, flow curve, turbine."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.predictors.predictor import Predictor
from hydro_twin.studies.l18.flow_characteristic import FlowCharacteristic
from hydro_twin.studies.l18.power_control import power_asked, PowerControl
from hydro_twin.studies.l18.turbine import Turbine

STEADY_SHARE = 0.1      # of a run, its end, over which a steady error is taken


@dataclass(frozen=True)
class Run:
    """One run of the loop, everything in units of nominal, shape (samples,)."""

    command: FloatArray
    opening: FloatArray
    power: FloatArray


def run_loop(servo: Predictor, curve: FlowCharacteristic, frequency: FloatArray, load: float,
             constants: Mapping[str, float]) -> Run:
    """Run the loop from rest at this load over a course of the grid's frequency.

    Args:
        servo: of the plant valve_servo, run freely.
        curve: steam flow against opening.
        frequency: at each sample of the servo's sample time [Hz].
        load: power asked for at nominal frequency [1].
        constants: of the controller and of the turbine, by name.

    Raises:
        DataError: the curve does not reach the load.
    """
    asked = power_asked(float(frequency[0]), load, constants)
    if not float(curve(0.0)) <= asked <= float(curve(curve.d_1)):
        raise DataError(f'the flow characteristic goes from {float(curve(0.0)):.3g} to '
                        f'{float(curve(curve.d_1)):.3g} and does not reach the power '
                        f'{asked:.3g} at the start')
    opening = curve.inverse(asked)
    turbine = Turbine(constants, servo.sample_time, asked)
    control = PowerControl(constants, servo.sample_time, opening, asked)
    stepper = servo.stepper('free_run')
    run = Run(*(np.empty(len(frequency)) for _ in range(3)))
    for k, f in enumerate(frequency):
        run.power[k] = turbine.power
        run.command[k] = control.step(power_asked(float(f), load, constants), turbine.power)
        run.opening[k] = stepper.step(run.command[k:k + 1], opening if k == 0 else math.nan)
        turbine.step(float(curve(run.opening[k])))
    return run


def agreement(measured: FloatArray, simulated: FloatArray) -> dict[str, float]:
    """Compare as [L18] does.

    Returns:
        `fit_percent`: 100 (1 - |y - yhat| / |y - mean y|); `steady_error_percent`: mean of
        yhat - y over the last tenth, of nominal; `relative_error_percent`: of the mean of y
        there.
    """
    spread = np.linalg.norm(measured - measured.mean())
    distance = np.linalg.norm(measured - simulated)
    end = slice(-max(1, round(STEADY_SHARE * len(measured))), None)
    error, level = np.mean(simulated[end] - measured[end]), np.mean(measured[end])
    return {
        'fit_percent': float(100 * (1 - distance / spread)) if spread > 0 else math.nan,
        'steady_error_percent': float(100 * error),
        'relative_error_percent': float(100 * error / level) if level else math.nan,
    }
