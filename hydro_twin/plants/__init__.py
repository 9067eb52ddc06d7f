"""The plants: one file a plant, with its linear laws, ports, parameters, units and bounds."""
from __future__ import annotations

from hydro_twin.errors import UserError
from hydro_twin.plants.control_valve import CONTROL_VALVE
from hydro_twin.plants.cylinder import CYLINDER
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.plants.plant import Constant, Laws, Parameter, Plant, Port, Signal
from hydro_twin.plants.positioning import POSITIONING
from hydro_twin.plants.valve_servo import VALVE_SERVO

__all__ = ['PLANTS', 'Constant', 'Laws', 'Parameter', 'Plant', 'Port', 'Signal', 'plant_named']

PLANTS = {plant.name: plant for plant in (LOAD_SIMULATOR, VALVE_SERVO, CYLINDER, POSITIONING,
                                          CONTROL_VALVE)}


def plant_named(name: str) -> Plant:
    """Return the plant of that name.

    Raises:
        UserError: there is none; the message lists those there are.
    """
    if name not in PLANTS:
        raise UserError(f'no plant {name!r}; there are {", ".join(PLANTS)}')
    return PLANTS[name]
