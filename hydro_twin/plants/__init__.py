"""The plants: one file a plant, each found here by being in this folder, or by an entry point."""
from __future__ import annotations

import importlib
import pkgutil

from hydro_twin.errors import ModelError, UserError
from hydro_twin.plants.plant import Constant, Laws, Parameter, Plant, Port, Signal
from hydro_twin.plugins import plugins

__all__ = ['PLANTS', 'Constant', 'Laws', 'Parameter', 'Plant', 'Port', 'Signal', 'plant_named']

GROUP = 'hydro_twin.plants'     # entry points of other packages, each a Plant


def _found() -> dict[str, Plant]:
    """Collect the plants of this folder, in the order of their names, then those of others.

    Raises:
        ModelError: an entry point is no plant, or two plants have one name.
    """
    modules = [importlib.import_module(f'{__name__}.{module.name}')
               for module in pkgutil.iter_modules(__path__)]
    plants: dict[str, Plant] = {}
    for plant in [value for module in modules for value in vars(module).values()
                  if isinstance(value, Plant)] + plugins(GROUP):
        if not isinstance(plant, Plant):
            raise ModelError(f'an entry point of {GROUP} is {plant!r}, not a Plant')
        if plants.setdefault(plant.name, plant) is not plant:
            raise ModelError(f'two plants are named {plant.name}')
        plant.check_equations()
    return plants


PLANTS = _found()


def plant_named(name: str) -> Plant:
    """Return the plant of that name.

    Raises:
        UserError: there is none; the message lists those there are.
    """
    if name not in PLANTS:
        raise UserError(f'no plant {name!r}; there are {", ".join(PLANTS)}')
    return PLANTS[name]
