"""The end of a valve's travel, as its flow characteristic gives it, in a model of the servo."""
from __future__ import annotations

from dataclasses import replace

from hydro_twin.effects import Placed
from hydro_twin.errors import UserError
from hydro_twin.model import Model, place
from hydro_twin.plants import Plant
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.studies.l18.flow_characteristic import FlowCharacteristic


def with_limit(model: Model, curve: FlowCharacteristic) -> Model:
    """Give a servo the limits 0 and d_1 of the curve, unless it has limits of its own.

    Raises:
        UserError: the model is of another plant, which has no such travel.
    """
    limit = limit_of(curve, model.plant)
    if any((placed.effect.id, placed.port.name) == ('saturation', 'stem')
           for placed in model.effects):
        return model
    return replace(model, effects=(*model.effects, limit))


def limit_of(curve: FlowCharacteristic, plant: Plant) -> Placed:
    """Place the limits 0 and d_1 of the curve at the stem.

    Raises:
        UserError: the plant has no such travel.
    """
    if plant.name != VALVE_SERVO.name:
        raise UserError(f'a flow characteristic is for the {VALVE_SERVO.name}, '
                        f'not for {plant.name}')
    return place('saturation', 'stem', {'lower': 0.0, 'upper': curve.d_1}, plant)
