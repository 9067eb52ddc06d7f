"""The plants: one file a plant, each found here by being in this folder, or by an entry point."""
from __future__ import annotations

from hydro_twin.errors import UserError
from hydro_twin.plants.plant import Constant, Laws, Parameter, Plant, Port, Signal
from hydro_twin.plugins import registered

__all__ = ['PLANTS', 'Constant', 'Laws', 'Parameter', 'Plant', 'Port', 'Signal', 'plant_named']

GROUP = 'hydro_twin.plants'     # entry points of other packages, each a Plant


PLANTS = registered(__name__, Plant, GROUP)
for _plant in PLANTS.values():
    _plant.check_equations()


def plant_named(name: str) -> Plant:
    """Return the plant of that name.

    Raises:
        UserError: there is none; the message lists those there are.
    """
    if name not in PLANTS:
        raise UserError(f'no plant {name!r}; there are {", ".join(PLANTS)}')
    return PLANTS[name]
