"""Models of the valve servo: as published, from a file, and without its nonlinear factors."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hydro_twin.errors import ModelError
from hydro_twin.fitting.physics import as_known
from hydro_twin.model import Model, read_model, Record
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.studies.l18.linear_loop import PUBLISHED


def published() -> Model:
    """Make the servo with the linear parameters of [L18]; k_1 is taken as known."""
    return Model(VALVE_SERVO, PUBLISHED._asdict(), VALVE_SERVO.sample_time,
                 record=Record(as_known(['k_1'])))


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
    values = {**model.values, 'tau': least['tau']}
    if model.parameters['k_1'].held:
        values['k_1'] = 1.0
    return replace(model, values=values, effects=(), record=Record())
