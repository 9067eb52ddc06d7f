"""Models of the valve servo: as published, from a file, and with the limit of a flow curve."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hydro_twin.errors import ModelError
from hydro_twin.model import Estimate, FittedEffect, Model, place, read_model
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.valve.flow_characteristic import FlowCharacteristic
from hydro_twin.valve.linear_loop import PUBLISHED


def published() -> Model:
    """Make the linear servo with the parameters of [L18]."""
    return Model(VALVE_SERVO, {name: Estimate(value) for name, value in
                               PUBLISHED._asdict().items()}, {}, VALVE_SERVO.sample_time)


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


def with_limit(model: Model, curve: FlowCharacteristic) -> Model:
    """Give a servo the limits 0 and d_1 of the curve, unless it has limits of its own."""
    if any((e.placed.effect.id, e.placed.port.name) == ('saturation', 'stem')
           for e in model.effects):
        return model
    limit = place('saturation', 'stem', {'lower': 0.0, 'upper': curve.d_1}, VALVE_SERVO)
    return replace(model, effects=(*model.effects, FittedEffect(limit)))
