"""--curve of the verb refit: the end of the valve's travel, from its flow characteristic."""
from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hydro_twin.commands.effect_option import EffectOption

if TYPE_CHECKING:
    from hydro_twin.effects import Placed
    from hydro_twin.plants import Plant


def effects(path: Path, plant: Plant) -> tuple[Placed, ...]:
    """Read the limits of a flow characteristic; see `limit_of`."""
    from hydro_twin.studies.l18.flow_characteristic import read_characteristic
    from hydro_twin.studies.l18.limit import limit_of

    return (limit_of(read_characteristic(path), plant),)


CURVE = EffectOption(
    'curve', 'CSV', 'flow characteristic of the valve servo, a table with the columns opening and '
    'flow: its end is the end of the travel in the model, saturation at the stem', effects)
