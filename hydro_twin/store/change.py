"""What changed between two models, in one sentence: by more than the errors of both."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from statistics import NormalDist

from hydro_twin.effects import Placed
from hydro_twin.model import Model

CHANCE = 0.01      # that anything is called moved between two fits of an unchanged rig
SAID = 4           # changes that the sentence names; the rest are counted
PREFIXED = ('m', 'rad', 's', 'V', 'N', 'Pa')
PREFIXES = ((1e6, 'M'), (1e3, 'k'), (1.0, ''), (1e-3, 'm'), (1e-6, 'µ'), (1e-9, 'n'))


@dataclass(frozen=True)
class Value:
    """A parameter of a model or of an effect in it, with its standard error if that is known."""

    value: float
    std_error: float | None
    unit: str


@dataclass(frozen=True)
class Moved:
    """A parameter that both models have.

    Attributes:
        what: as 'coupling backlash' or 'J'.
        z: the difference over its standard error; 0 where no error is known.
    """

    what: str
    before: Value
    after: Value
    z: float


@dataclass(frozen=True)
class Change:
    """What became different from one model to the next.

    Attributes:
        moved: beyond their errors, the surest first.
        appeared, gone: effects, as 'motor friction (coulomb 10.2 N m)'.
        says: all of it in one sentence.
    """

    moved: tuple[Moved, ...]
    appeared: tuple[str, ...]
    gone: tuple[str, ...]
    says: str


def change(before: Model, after: Model) -> Change:
    """Compare two models of one plant.

    A parameter has moved where its difference is beyond what errors explain: a two-sided z-test
    on the standard errors that both files state, at `CHANCE` for all parameters together
    (Bonferroni). One without an error in either file is not tested.

    Args:
        before: the older model.
        after: the newer one.

    Returns:
        What moved, appeared and went, and a sentence of it.
    """
    ours, theirs = _effects(before), _effects(after)
    pairs = [(name, one, theirs_too) for name, one in parameters(before).items()
             if (theirs_too := parameters(after).get(name)) is not None]
    pairs += [(label, one, other[label]) for key in ours.keys() & theirs.keys()
              for other in [effect_values(after, theirs[key])]
              for label, one in effect_values(before, ours[key]).items() if label in other]
    tested = [Moved(what, one, other, _z(one, other)) for what, one, other in pairs]
    count = sum(bool(move.z) for move in tested)
    limit = NormalDist().inv_cdf(1.0 - 0.5 * CHANCE / count) if count else math.inf
    moved = tuple(sorted((m for m in tested if abs(m.z) > limit), key=lambda m: -abs(m.z)))
    appeared = tuple(_described(after, theirs[key]) for key in theirs if key not in ours)
    gone = tuple(name_of(before.effects[ours[key]]) for key in ours if key not in theirs)
    return Change(moved, appeared, gone, _sentence(moved, appeared, gone))


def parameters(model: Model) -> dict[str, Value]:
    """Give the parameters of the plant by name."""
    units = {p.name: p.unit for p in model.plant.parameters}
    return {name: Value(p.value, p.std_error if p.identifiable else None, units[name])
            for name, p in model.parameters.items()}


def effect_values(model: Model, index: int) -> dict[str, Value]:
    """Give the parameters of an effect that are in use, by what a sentence calls them."""
    placed = model.effects[index]
    name = name_of(placed)
    alone = len(placed.effect.parameters) == 1
    return {name if alone else f'{p.name} of the {name}':
            Value(value, model.record.std_error(index, p.name), placed.effect.unit(p, placed.port))
            for p, value in placed.in_use}


def name_of(placed: Placed) -> str:
    """Name an effect with its port, as 'coupling backlash'."""
    kind = (placed.effect.id if placed.effect.explains else
            f'curve over {placed.effect.reads[0]}')
    return f'{placed.port.name} {kind}'.replace('_', ' ')


def _effects(model: Model) -> Mapping[tuple[str, ...], int]:
    """Index the effects by what makes them the same; the second of a kind is counted."""
    found: dict[tuple[str, ...], int] = {}
    for k, placed in enumerate(model.effects):
        key = (placed.effect.id, placed.port.name, placed.port.kind, *placed.effect.reads)
        while key in found:
            key = (*key, 'again')
        found[key] = k
    return found


def _z(before: Value, after: Value) -> float:
    """Return the difference over its standard error; 0 where that is not known."""
    if before.std_error is None or after.std_error is None:
        return 0.0
    error = math.hypot(before.std_error, after.std_error)
    return (after.value - before.value) / error if error > 0.0 else 0.0


def _described(model: Model, index: int) -> str:
    placed, values = model.effects[index], effect_values(model, index)
    if not placed.effect.explains:
        return name_of(placed)
    given = ', '.join(f'{label.partition(" of the ")[0] + " " if " of the " in label else ""}'
                      f'{quantity(one.value, one.unit)}' for label, one in values.items())
    return f'{name_of(placed)} ({given})' if given else name_of(placed)


def _sentence(moved: tuple[Moved, ...], appeared: tuple[str, ...], gone: tuple[str, ...]) -> str:
    """Write it, effects first."""
    parts = [f'{name} appeared' for name in appeared] + [f'{name} went' for name in gone]
    parts += [_moved(move) for move in moved]
    if not parts:
        return 'nothing changed beyond the errors'
    rest = len(parts) - SAID
    return '; '.join(parts[:SAID]) + (f'; and {rest} more' if rest > 0 else '')


def _moved(move: Moved) -> str:
    before, after = move.before.value, move.after.value
    verb = 'grew' if abs(after) > abs(before) else 'fell'
    verb = 'changed' if before * after < 0.0 else verb
    scale, unit = _scale(max(abs(before), abs(after)), move.after.unit)
    return f'{move.what} {verb} from {before / scale:.3g} to {after / scale:.3g} {unit}'.rstrip()


def quantity(value: float, unit: str) -> str:
    """Write a value with its unit, as '1.6 mrad'."""
    scale, named = _scale(abs(value), unit)
    return f'{value / scale:.3g} {named}'.rstrip()


def _scale(size: float, unit: str) -> tuple[float, str]:
    """Choose a prefix for a unit that takes one."""
    if unit in PREFIXED and size > 0.0:
        for scale, prefix in PREFIXES:
            if size >= 0.9995 * scale:
                return scale, f'{prefix}{unit}'
    return 1.0, '' if unit == '1' else unit
