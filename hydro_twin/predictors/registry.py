"""The kinds of predictor: each found by its `Kind` in this folder, or by an entry point."""
from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_twin.errors import ModelError
from hydro_twin.plugins import registered
from hydro_twin.predictors.kind import Kind

if TYPE_CHECKING:
    from hydro_twin.model import Model
    from hydro_twin.predictors.predictor import Predictor

GROUP = 'hydro_twin.predictors'     # entry points of other packages, each a Kind


@cache
def kinds() -> dict[str, Kind]:
    """Return all kinds by name, imported at the first call: their modules import this one."""
    return registered('hydro_twin.predictors', Kind, GROUP)


def kind_named(name: object) -> Kind:
    """Return the kind of that name.

    Raises:
        ModelError: there is none; the message lists those there are.
    """
    if not isinstance(name, str) or name not in kinds():
        raise ModelError(f'predictor {name!r}; there are {", ".join(kinds())}')
    return kinds()[name]


def make_predictor(model: Model, folder: Path) -> Predictor:
    """Make the predictor that a model describes; its weights lie in the folder.

    Raises:
        ModelError: they are missing, or do not fit the model.
    """
    return kind_named(model.kind).make(model, folder)
