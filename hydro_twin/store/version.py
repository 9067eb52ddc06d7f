"""One model of a store, with all that was decided on it."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, UTC
import json
from pathlib import Path
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.model import Model, read_model

CHAMPION, CHALLENGER = 'champion', 'challenger'
ALIASES = (CHAMPION, CHALLENGER)
MODELS, CAPTURES = 'models', 'captures'
MODEL, DECISION = 'model.yaml', 'decision.json'
REGIMES = 'regimes.json'
REPORTS = ('report.json', 'report.html', REGIMES)
ENTERED, PROMOTED, DISCARDED = 'entered', 'promoted', 'discarded'
CONFIRMED, RECOMMENDED = 'confirmed', 'recommended'
ROLLED_BACK, INTERRUPTED = 'rolled back', 'interrupted'
MOVES = (PROMOTED, ROLLED_BACK)      # decisions after which the champion is another version


class StoreError(UserError):
    """A store cannot be read, or does not have what is asked of it."""


@dataclass(frozen=True)
class Version:
    """One model of a store.

    Attributes:
        name: '0007'.
        folder: that it lies in.
        record: what decision.json holds.
    """

    name: str
    folder: Path
    record: Mapping[str, Any]

    @property
    def model_file(self) -> Path:
        """Its model file."""
        return self.folder / MODEL

    @property
    def parent(self) -> str | None:
        """The version that it was made from."""
        parent: str | None = self.record.get('parent')
        return parent

    @property
    def decisions(self) -> list[dict[str, Any]]:
        """All that was decided on it, the oldest first."""
        return list(self.record['decisions'])

    def model(self) -> Model:
        """Read the model.

        Raises:
            ModelError: the file is damaged.
        """
        return read_model(self.model_file)


def read_version(folder: Path) -> Version:
    """Read a version.

    Raises:
        StoreError: its decision.json is damaged.
    """
    path = folder / DECISION
    try:
        record = json.loads(path.read_text('utf-8'))
        _check(record)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError(f'{path}: damaged ({type(error).__name__}: {error})') from error
    return Version(folder.name, folder, record)


def _check(record: Any) -> None:
    """Refuse a record that lacks what its readers take as there.

    Raises:
        KeyError: an entry is missing.
        TypeError: one is of another kind.
        ValueError: a time is none, or nothing was decided.
    """
    if not isinstance(record['changed'], str):
        raise TypeError('changed')
    if not isinstance(record['decisions'], list):
        raise TypeError('decisions')
    if not record['decisions']:
        raise ValueError('decisions: none, not even that it was entered')
    for made in record['decisions']:
        needed = ('what', 'when', 'by', *(('to',) if made['what'] == ROLLED_BACK else ()))
        if wrong := [name for name in needed if not isinstance(made[name], str)]:
            raise TypeError(wrong[0])
        datetime.fromisoformat(made['when'])


def entered(version: Version) -> datetime:
    """Say when a version was entered."""
    return datetime.fromisoformat(version.decisions[0]['when'])


def since(version: Version) -> str:
    """Say since when a version is there, as 'since 3 May 2026', or the hour if it was today."""
    then = entered(version)
    if then.date() == datetime.now(UTC).date():
        return f'since {then:%H:%M} UTC'
    return f'since {then.day} {then:%B %Y}'


def decision(what: str, by: str, evidence: Mapping[str, Any] | None = None, why: str = '',
             ) -> dict[str, Any]:
    """Write a decision down, with the time."""
    when = datetime.now(UTC).isoformat(timespec='microseconds')
    return {'what': what, 'when': when, 'by': by, **({'why': why} if why else {}),
            **({'evidence': dict(evidence)} if evidence else {})}


def as_json(record: Mapping[str, Any]) -> str:
    """Lay decision.json out."""
    return json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + '\n'
