"""Models of the valve servo: as published, from a file, and without its nonlinear factors."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hydro_twin.errors import ModelError
from hydro_twin.model import Estimate, Model, read_model
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.studies.l18.linear_loop import PUBLISHED


def published() -> Model:
    """Make the servo with the linear parameters of [L18]; k_1 is taken as known."""
    T_y, T_c, tau, k_1 = (Estimate(value) for value in PUBLISHED)
    parameters = {'T_y': T_y, 'T_c': T_c, 'tau': tau,
                  'k_1': replace(k_1, identifiable=False, held=True)}
    return Model(VALVE_SERVO, parameters, {}, VALVE_SERVO.sample_time)


def read_servo(path: Path) -> Model:
    """Read a model file of a valve servo.

    Raises:
        ModelError: it cannot be used, or is of another plant or of another kind.
    """
    model = read_model(path)
    if model.plant is not VALVE_SERVO or model.kind != 'analytical':
        raise ModelError(f'{path}: an analytical model of valve_servo is needed, this is '
                         f'{model.kind} of {model.plant.name}')
    return model


def without_nonlinear_factors(model: Model) -> Model:
    """Leave converter and actuator, the linear part of [L18] figure 3.

    The effects go; tau, which stands for the dead zone l_1, becomes the least of its box; and
    k_1 becomes 1 where it was known. Where it was not, T_c / k_1 is all that the model holds, and
    stays.
    """
    least = {p.name: p.lower for p in VALVE_SERVO.parameters}
    parameters = {**model.parameters, 'tau': Estimate(least['tau'])}
    if parameters['k_1'].held:
        parameters['k_1'] = Estimate(1.0)
    return replace(model, parameters=parameters, effects=())
