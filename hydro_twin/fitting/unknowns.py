"""The unknowns of a fit: which there are, their bounds, and their place in a candidate."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.system import HOLD

LARGEST = 700.0         # logarithm of a number that is still finite


@dataclass(frozen=True)
class Unknown:
    """One number that a fit searches, and how it stands in the candidate.

    Attributes:
        owner: '' for the plant, 'timing', or the index of an effect.
        scale: of a coordinate that is not logarithmic.
    """

    name: str
    owner: str
    lower: float
    upper: float
    log: bool
    scale: float = 1.0

    def coordinate(self, value: float) -> float:
        """Map a value to the coordinate of the search."""
        return math.log(value) if self.log else value / self.scale

    def value(self, coordinate: float) -> float:
        """Map a coordinate back, kept within the bounds against rounding, and finite."""
        raw = math.exp(min(coordinate, LARGEST)) if self.log else coordinate * self.scale
        return min(max(raw, self.lower), self.upper)


def label(unknown: Unknown) -> str:
    """Name an unknown within its fit: parameters plainly, others with their owner."""
    return unknown.name if unknown.owner == '' else f'{unknown.owner}:{unknown.name}'


def get(candidate: Model, unknown: Unknown) -> float:
    """Read the value of an unknown."""
    if unknown.owner == '':
        return candidate.values[unknown.name]
    if unknown.owner == 'timing':
        return candidate.timing.get(unknown.name, 0.0)
    return candidate.effects[int(unknown.owner)].named[unknown.name]


def coordinates_of(candidate: Model, unknowns: Sequence[Unknown]) -> FloatArray:
    """Read the coordinates of unknowns, (d,)."""
    return np.array([unknown.coordinate(get(candidate, unknown)) for unknown in unknowns])


def put(candidate: Model, unknowns: Sequence[Unknown], values: Sequence[float]) -> Model:
    """Set the values of unknowns in a new candidate."""
    plain = dict(candidate.values)
    timing = dict(candidate.timing)
    effects = [dict(placed.named) for placed in candidate.effects]
    for unknown, value in zip(unknowns, values, strict=True):
        if unknown.owner == '':
            plain[unknown.name] = value
        elif unknown.owner == 'timing':
            timing[unknown.name] = value
        else:
            effects[int(unknown.owner)][unknown.name] = value
    return replace(
        candidate, values=plain, timing=timing,
        effects=tuple(replace(placed, values=tuple(named.values()))
                      for placed, named in zip(candidate.effects, effects, strict=True)))


def plant_unknowns(plant: Plant, within: str, sample_time: float = 0.0) -> list[Unknown]:
    """List the parameters of a plant as unknowns.

    Args:
        plant: the plant.
        within: 'box', all of them within the search box; 'range', all within the physical range;
            or 'physical', within that, and of each combination that acts only together all but
            one left where they are.
        sample_time: of what is fitted [s], see `Parameter.least_samples`.
    """
    if within == 'box':
        return [Unknown(p.name, '', p.lower, p.upper, True) for p in plant.parameters]
    left = left_alone(plant) if within == 'physical' else set()
    return [Unknown(p.name, '', max(p.minimum, p.least_samples * sample_time), p.maximum, True)
            for p in plant.parameters if p.name not in left]


def left_alone(plant: Plant) -> set[str]:
    """Name the parameters that stay where they are, since others can stand in for them."""
    return {name for combination in plant.combinations for name in list(combination)[1:]}


def log_search_box(plant: Plant) -> dict[str, tuple[float, float]]:
    """Logarithmic search box of each parameter, where those that are not fitted are in the middle.

    The box of a parameter that stands for a combination is that of the combination.
    """
    box = {p.name: (math.log(p.lower), math.log(p.upper)) for p in plant.parameters}
    for combination in plant.combinations:
        first, *others = combination
        sign = combination[first]
        room = sum(0.5 * (box[name][1] - box[name][0]) for name in others)
        assert abs(sign) == 1
        box[first] = (box[first][0] - room, box[first][1] + room)
    return box


def effect_unknowns(index: int, placed: Placed) -> list[Unknown]:
    """List the parameters of an effect that are not fixed or left out of its law.

    The values of a curve, any of which may be near zero, share one scale.
    """
    largest = max((abs(value) for p, value in zip(
        placed.effect.parameters, placed.values, strict=True)
        if not p.fixed and math.isfinite(value)), default=1.0)
    return [Unknown(p.name, str(index), p.lower, p.upper, p.log,
                    (abs(value) if placed.effect.explains else 0.0) or largest or 1.0)
            for p, value in placed.in_use if not p.fixed]


def timing_unknowns(candidate: Model) -> list[Unknown]:
    """List how late commands act, as unknowns, in a range of one sample.

    A held command may have been set a moment before its stamp; what the stamps cannot resolve must
    not be taken for an effect. It is half a sample late in the mean, one that is interpolated is
    not.
    """
    T = candidate.sample_time
    latest = 0.0 if candidate.interpolation == HOLD else 0.5 * T
    return [Unknown(signal.name, 'timing', latest - T, latest, False, T)
            for signal in candidate.plant.inputs if signal.held]


def unknowns_of(candidate: Model) -> list[Unknown]:
    """List all unknowns of a candidate: physical parameters, timing and effects.

    A delay takes the place of the timing. Effects beside which a free curve was added are held,
    since the curve can imitate them.
    """
    plant = candidate.plant
    delayed = any(placed.effect.shifts for placed in candidate.effects)
    unknowns = plant_unknowns(plant, 'physical', candidate.sample_time)
    unknowns += [] if delayed else timing_unknowns(candidate)
    held = max((k for k, placed in enumerate(candidate.effects) if not placed.effect.explains),
               default=0)
    for index, placed in enumerate(candidate.effects[held:], held):
        unknowns += effect_unknowns(index, placed)
    return unknowns
