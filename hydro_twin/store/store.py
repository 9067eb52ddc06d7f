"""A folder of model versions that a person can read and git can hold.

    models/0007/model.yaml      and the weights file beside it, if the model has one
    models/0007/decision.json   parent, what changed, and each decision on it with its evidence
    models/0007/report.json     of the trace that it comes from, with report.html, if any
    champion, challenger        aliases: the version that runs, and the one that is judged

A version's folder is made aside and renamed, an alias is a file that is replaced. Whenever a
writer is killed, a reader finds whole files. What a killed writer left has a name with a dot in
front; readers pass it over and the next writer takes it away.
"""
from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import fcntl
from itertools import pairwise
import os
from pathlib import Path
import re
import shutil
from typing import Any

from hydro_twin.files import sync, write_whole
from hydro_twin.model import read_model
from hydro_twin.store.change import change
from hydro_twin.store.version import (
    ALIASES,
    as_json,
    CAPTURES,
    CHALLENGER,
    CHAMPION,
    DECISION,
    decision,
    DISCARDED,
    ENTERED,
    INTERRUPTED,
    MODEL,
    MODELS,
    MOVES,
    PROMOTED,
    read_version,
    REPORTS,
    ROLLED_BACK,
    since,
    StoreError,
    Version,
)

LEFT = re.compile(r'\..+\.\d+')       # what `written_whole` and `enter` write aside: .NAME.PID


class Store:
    """The versions and aliases of a folder; several processes may use it."""

    def __init__(self, path: Path) -> None:
        """Use a folder, which need not be there yet."""
        self.path = path

    @classmethod
    def opened(cls, path: Path) -> Store:
        """Use a store that is there.

        Raises:
            StoreError: there is none.
        """
        if not (path / MODELS).is_dir():
            raise StoreError(f'{path}: no store (it has no folder {MODELS}); '
                             "'hydro-twin promote STORE --model FILE' begins one")
        return cls(path)

    # Reading

    def versions(self) -> list[Version]:
        """List all versions, the oldest first.

        Raises:
            StoreError: a decision.json is damaged.
        """
        folder = self.path / MODELS
        if not folder.is_dir():
            return []
        return [read_version(one) for one in sorted(folder.iterdir())
                if re.fullmatch(r'\d{4,}', one.name)]

    def version(self, name: str) -> Version:
        """Find a version by its number, or by an alias.

        Raises:
            StoreError: there is none.
        """
        found = self.alias(name) if name in ALIASES else None
        wanted = found or (f'{int(name):04d}' if name.isdecimal() else name)
        folder = self.path / MODELS / wanted
        if not re.fullmatch(r'\d{4,}', wanted) or not folder.is_dir():
            there = ', '.join(one.name for one in self.versions()) or 'none'
            raise StoreError(f'{self.path}: no version {name}; there are: {there}')
        return read_version(folder)

    def alias(self, name: str) -> str | None:
        """Say which version an alias stands for; None where it stands for none.

        Raises:
            StoreError: the file holds something else.
        """
        try:
            text = (self.path / name).read_text('utf-8').strip()
        except FileNotFoundError:
            return None
        if text and not (re.fullmatch(r'\d{4,}', text) and (self.path / MODELS / text).is_dir()):
            raise StoreError(f'{self.path / name}: {text!r} is no version of this store')
        return text or None

    @property
    def champion(self) -> Version | None:
        """The version that runs."""
        name = self.alias(CHAMPION)
        return self.version(name) if name else None

    @property
    def challenger(self) -> Version | None:
        """The version that is judged."""
        name = self.alias(CHALLENGER)
        return self.version(name) if name else None

    def predecessor(self) -> Version | None:
        """Return the version that the champion took the place of; None if there was none."""
        champion = self.champion
        if champion is None:
            return None
        for made in reversed(champion.decisions):
            if made['what'] == PROMOTED:
                return self.version(made['replaces']) if made.get('replaces') else None
        return None

    # Writing

    def enter(self, model: Path, by: str, *, reports: Path | None = None,
              bag: Mapping[str, Any] | None = None, as_challenger: bool = False) -> Version:
        """Add a model as a new version; its parent is the champion.

        Args:
            model: its file; weights named in it are copied from beside it.
            by: who or what enters it.
            reports: folder of a trace, whose report.json and report.html are copied.
            bag: path and SHA-256 of the recording that it was made from, and why that was made.
            as_challenger: whether the alias challenger moves to it.

        Raises:
            ModelError: the model file is damaged.
            StoreError: it is a model of another plant than the champion.
        """
        made = read_model(model)
        with self._writing() as folder:
            champion = self.champion
            parent = champion.model() if champion else None
            if parent is not None and parent.plant.name != made.plant.name:
                raise StoreError(f'{model}: a model of {made.plant.name}; the store holds '
                                 f'models of {parent.plant.name}')
            taken = [int(one.name) for one in self.versions()]
            name = f'{max(taken, default=0) + 1:04d}'
            part = folder / f'.{name}.{os.getpid()}'
            part.mkdir()
            shutil.copyfile(model, part / MODEL)
            if made.network:
                shutil.copyfile(model.parent / made.network, part / made.network)
            for report in REPORTS if reports else ():
                if reports and (reports / report).is_file():
                    shutil.copyfile(reports / report, part / report)
            record = {
                'version': name, 'parent': champion.name if champion else None,
                'changed': (f'{change(parent, made).says} {since(champion)}'
                            if champion and parent else 'the first model'),
                **({'bag': dict(bag)} if bag else {}),
                'decisions': [decision(ENTERED, by)]}
            (part / DECISION).write_text(as_json(record), 'utf-8')
            for path in part.iterdir():
                sync(path)
            sync(part)
            part.rename(folder / name)
            sync(folder)
            if as_challenger:
                self._point(CHALLENGER, name)
            return self.version(name)

    def promote(self, name: str, by: str, evidence: Mapping[str, Any] | None = None) -> Version:
        """Make a version the champion.

        Raises:
            StoreError: there is no such version, or it is the champion.
        """
        with self._writing():
            version, champion = self.version(name), self.champion
            if champion is not None and champion.name == version.name:
                raise StoreError(f'{self.path}: version {version.name} is the champion already')
            # The alias comes last: it is what makes the change, all at once.
            self._decide(version, PROMOTED, by, evidence,
                         replaces=champion.name if champion else None)
            self._point(CHAMPION, version.name)
            if self.alias(CHALLENGER) == version.name:
                self._point(CHALLENGER, '')
            return self.version(version.name)

    def roll_back(self, by: str, evidence: Mapping[str, Any] | None = None, why: str = '',
                  ) -> Version:
        """Make the predecessor of the champion the champion again.

        Raises:
            StoreError: there is none.
        """
        with self._writing():
            champion, predecessor = self.champion, self.predecessor()
            if champion is None or predecessor is None:
                raise StoreError(f'{self.path}: nothing to go back to: '
                                 + (f'version {champion.name} is the first champion' if champion
                                    else 'there is no champion'))
            self._decide(champion, ROLLED_BACK, by, evidence, why, to=predecessor.name)
            self._point(CHAMPION, predecessor.name)
            return predecessor

    def decide(self, name: str, what: str, by: str, evidence: Mapping[str, Any] | None = None,
               why: str = '') -> Version:
        """Note a decision on a version that leaves the champion; a discarded one has no alias.

        Raises:
            StoreError: there is no such version.
        """
        with self._writing():
            self._decide(self.version(name), what, by, evidence, why)
            if what == DISCARDED and self.alias(CHALLENGER) == self.version(name).name:
                self._point(CHALLENGER, '')
            return self.version(name)

    @contextmanager
    def _writing(self) -> Iterator[Path]:
        """Keep other writers out, and mend what a killed one left; gives the folder of versions.

        Raises:
            StoreError: the folder cannot be written.
        """
        folder = self.path / MODELS
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with (self.path / '.lock').open('w') as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                if not (self.path / '.gitignore').exists():
                    write_whole(self.path / '.gitignore', f'.lock\n.*.*\n{CAPTURES}/\n',
                                durable=True)
                self._mend(folder)
                yield folder
        except OSError as error:
            raise StoreError(f'{error.filename or self.path}: {error.strerror}') from error

    def _mend(self, folder: Path) -> None:
        """Remove leftovers, and mark an interrupted move of the champion.

        That is its last move, if the alias does not show it.
        """
        for left in [*folder.iterdir(), *folder.glob('*/.*'), *self.path.iterdir()]:
            if LEFT.fullmatch(left.name):
                if left.is_dir():
                    shutil.rmtree(left, ignore_errors=True)
                else:
                    left.unlink(missing_ok=True)
        moves = [(made, after, version) for version in self.versions()
                 for made, after in pairwise([*version.decisions, None])
                 if made and made['what'] in MOVES]
        if not moves:
            return
        made, after, version = max(moves, key=lambda move: str(move[0]['when']))
        wanted = made['to'] if made['what'] == ROLLED_BACK else version.name
        if self.alias(CHAMPION) != wanted and not (after and after['what'] == INTERRUPTED):
            self._decide(version, INTERRUPTED, 'the next writer', None,
                         f'the champion is not {wanted}: the move was cut short, or the alias was '
                         'set by hand')

    def _decide(self, version: Version, what: str, by: str,
                evidence: Mapping[str, Any] | None = None, why: str = '',
                **more: str | None) -> None:
        """Add to what was decided on a version."""
        made = decision(what, by, evidence, why) | more
        write_whole(version.folder / DECISION, as_json(
            {**version.record, 'decisions': [*version.decisions, made]}), durable=True)

    def _point(self, alias: str, name: str) -> None:
        """Have an alias stand for a version, or for none."""
        write_whole(self.path / alias, f'{name}\n', durable=True)
