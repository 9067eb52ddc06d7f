"""The line of descent of a store: a row for each version, and its values over time."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from hydro_twin.errors import ModelError
from hydro_twin.store.change import effect_values, parameters, Value
from hydro_twin.store.store import Store
from hydro_twin.store.version import ALIASES, entered, ROLLED_BACK, Version

DAY = 86400.0     # [s]


@dataclass(frozen=True)
class Row:
    """A version in the table.

    Attributes:
        when: it was entered.
        alias: 'champion', 'challenger' or ''.
        captured: why the recording that it was made from was captured, '' where there is none.
        verdict: the last decision on it, with its reason or evidence in short.
        changed: from its parent, in one sentence.
    """

    version: str
    when: datetime
    alias: str
    parent: str
    captured: str
    verdict: str
    changed: str
    plant: str


@dataclass(frozen=True)
class Course:
    """A parameter of the plant or of an effect over the versions that have it.

    Attributes:
        days: since the first version was entered.
        values: with standard errors, where those are known.
        versions: their names.
    """

    name: str
    days: tuple[float, ...]
    values: tuple[Value, ...]
    versions: tuple[str, ...]


def rows(store: Store) -> list[Row]:
    """List the versions, the oldest first.

    Raises:
        StoreError: the store is damaged.
    """
    aliases = {store.alias(alias): alias for alias in ALIASES}
    found = []
    for version in store.versions():
        try:
            plant = version.model().plant.title
        except ModelError:
            plant = ''
        found.append(Row(version.name, entered(version), aliases.get(version.name, ''),
                         version.parent or '',
                         '; '.join((version.record.get('bag') or {}).get('why', [])),
                         verdict(version), str(version.record['changed']), plant))
    return found


def verdict(version: Version) -> str:
    """Say the last decision on a version in a few words."""
    last = version.decisions[-1]
    said = f'rolled back to {last["to"]}' if last['what'] == ROLLED_BACK else str(last['what'])
    evidence = last.get('evidence') or {}
    shown = f', evidence {evidence["e_value"]:.3g}' if 'e_value' in evidence else ''
    why = f' ({last["why"]})' if last.get('why') else ''
    return f'{said} by {last["by"]}{shown}{why}'


def courses(versions: Sequence[Version]) -> list[Course]:
    """Follow each parameter over versions; a version whose model is damaged is left out.

    Args:
        versions: the oldest first.
    """
    if not versions:
        return []
    begin = entered(versions[0])
    found: dict[str, list[tuple[float, Value, str]]] = {}
    for version in versions:
        try:
            model = version.model()
        except ModelError:
            continue
        values: dict[str, Value] = dict(parameters(model))
        for k, placed in enumerate(model.effects):
            if placed.effect.explains:
                values |= effect_values(model, k)
        days = (entered(version) - begin).total_seconds() / DAY
        for name, value in values.items():
            found.setdefault(name, []).append((days, value, version.name))
    return [Course(name, *(tuple(column) for column in zip(*points, strict=True)))
            for name, points in found.items()]


def plain(row: Row) -> Mapping[str, Any]:
    """Lay a row out for JSON."""
    return {'version': row.version, 'when': row.when.isoformat(timespec='seconds'),
            'alias': row.alias, 'parent': row.parent, 'captured': row.captured,
            'verdict': row.verdict, 'changed': row.changed}
