"""An effect at a port of a plant, by their names, with values that are checked."""
from __future__ import annotations

from collections.abc import Mapping
import math

from hydro_twin.effects import Effect, EFFECTS, Placed, sites
from hydro_twin.effects.curve import of_kind
from hydro_twin.errors import ModelError
from hydro_twin.plants import Plant, Port


def effect_at(identifier: str, port_name: str, plant: Plant) -> tuple[Effect, Port]:
    """Find the effect of that id and the port of that name on which it sits.

    Raises:
        ModelError: there is none.
    """
    for effect in EFFECTS:
        for port in sites(effect, plant):
            if effect.id == identifier and port.name == port_name:
                return effect, port
    possible = sorted({f'{effect.id}@{port.name}' for effect in EFFECTS
                       for port in sites(effect, plant)})
    raise ModelError(f'{plant.name} takes no effect {identifier} at port {port_name}; '
                     f'it takes {", ".join(possible)}')


def place(identifier: str, port_name: str, parameters: Mapping[str, float],
          plant: Plant) -> Placed:
    """Put an effect with these parameters on a port; refinements left out are neutral.

    A limit that is left out, or infinite, limits nothing.

    Raises:
        ModelError: no such effect there, or a parameter missing, unknown or out of range.
    """
    return filled(*effect_at(identifier, port_name, plant), parameters)


def curve_at(port_name: str, kind: str, signal: str, plant: Plant) -> tuple[Effect, Port]:
    """Give the curve over a signal at the port of that name and kind.

    Raises:
        ModelError: no such port or signal.
    """
    for port in plant.ports:
        if (port.name, port.kind) == (port_name, kind) and signal in ('value', *port.signals):
            return of_kind(port.kind, signal), port
    raise ModelError(f'{plant.name} takes no curve over {signal} at port {port_name} ({kind})')


def filled(effect: Effect, port: Port, parameters: Mapping[str, float]) -> Placed:
    """Give an effect its parameters, each within its range.

    Raises:
        ModelError: a parameter is missing, unknown or out of range.
    """
    identifier = effect.id
    known = {parameter.name for parameter in effect.parameters}
    if unknown := sorted(set(parameters) - known):
        raise ModelError(f'effect {identifier} has no parameter {", ".join(unknown)}; '
                         f'it has {", ".join(sorted(known))}')
    values = []
    for p in effect.parameters:
        neutral = p.unreached if p.refinement is None else p.refinement
        value = parameters.get(p.name, neutral)
        if value is None:
            raise ModelError(f'effect {identifier}: parameter {p.name} is missing')
        if p.unreached is not None and value == math.copysign(math.inf, p.unreached):
            value = p.unreached
        if not p.lower <= value <= p.upper:
            raise ModelError(f'effect {identifier}: {p.name} = {value:g} is outside '
                             f'{p.lower:g} to {p.upper:g}')
        values.append(float(value))
    placed = Placed(effect, port, tuple(values))
    for low, high in (('low', 'high'), ('lower', 'upper')):
        if low in placed.named and not placed.named[low] < placed.named[high]:
            raise ModelError(f'effect {identifier}: {low} = {placed.named[low]:g} must be below '
                             f'{high} = {placed.named[high]:g}')
    return placed
