"""An option of the verb refit that gives the model effects that are known beforehand."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hydro_twin.effects import Placed
    from hydro_twin.plants import Plant

GROUP = 'hydro_twin.effect_options'     # entry points: that of a study, and of other packages


@dataclass(frozen=True)
class EffectOption:
    """An option that reads effects from a file. Its module imports nothing heavy at its top.

    Attributes:
        name: 'curve' for --curve.
        metavar: what the file is, for --help.
        help: for --help.
        effects: reads the file, for a plant; what is wrong with either is raised.
    """

    name: str
    metavar: str
    help: str
    effects: Callable[[Path, Plant], tuple[Placed, ...]]
