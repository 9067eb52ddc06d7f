"""Between which values the evidence alone may promote a parameter."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import TYPE_CHECKING

from hydro_twin.errors import UserError

if TYPE_CHECKING:
    from hydro_twin.model import Model
    from hydro_twin.plants import Plant


def parse(entries: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Read limits, each NAME=LOW..HIGH; an empty text stands for none.

    Raises:
        UserError: one is not of this form, or its lower limit is above the upper.
    """
    found = {}
    for entry in filter(None, entries):
        name, _, span = entry.partition('=')
        try:
            low, high = map(float, span.split('..'))
        except ValueError:
            low = high = math.nan
        if not (name and low <= high):
            raise UserError(f'limits: {entry!r}: NAME=LOW..HIGH is needed, as B_m=10..100 or '
                            'friction@motor:coulomb=0..20')
        found[name] = low, high
    return found


def check_names(limits: Mapping[str, tuple[float, float]], plant: Plant) -> None:
    """Refuse limits of what is no parameter of a plant: a misspelt one would never apply.

    Args:
        limits: by name; that of a parameter of an effect is not checked.
        plant: whose parameters they should be.

    Raises:
        UserError: there is one; the message lists the parameters that there are.
    """
    if said := _unknown(limits, plant):
        raise UserError(said)


def _unknown(limits: Mapping[str, tuple[float, float]], plant: Plant) -> str:
    """Say which limits are of no parameter of a plant, or ''."""
    known = {**{p.name: None for p in plant.parameters}, **plant.constant_values()}
    wrong = [name for name in limits if '@' not in name and name not in known]
    if not wrong:
        return ''
    return f'limits: no parameter {", ".join(wrong)}; {plant.name} has {", ".join(known)}'


def beyond(model: Model, limits: Mapping[str, tuple[float, float]]) -> list[str]:
    """Say which parameters of a model are beyond their limits.

    Args:
        model: the model.
        limits: by name; of a parameter of an effect ID@PORT:NAME. An effect that the model does
            not have is within any limits, but a parameter that its plant does not have in none.
    """
    values = {**model.values, **{
        f'{placed.effect.id}@{placed.port.name}:{name}': value
        for placed in model.effects for name, value in placed.named.items()}}
    unknown = _unknown(limits, model.plant)
    return [*([unknown] if unknown else []), *(
        f'{name} {values[name]:.4g} is not within {low:g} to {high:g}'
        for name, (low, high) in limits.items()
        if name in values and not low <= values[name] <= high)]
