"""What the twin runs, and what it should run: the champion."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.keep.ring import SECOND
from hydro_twin.keep.settings import OBSERVE
from hydro_twin.recording.digest import source_of
from hydro_twin.store.store import Store
from hydro_twin.store.version import Version

BY = 'keep'
RETRY = 10.0     # how long the twin may take to run what it was asked to [s]


class Follower:
    """Has the twin run the champion, unless the policy is to leave it alone.

    Attributes:
        runs: what the twin says of the model that it runs; None before it does.
    """

    def __init__(self, store: Store, get: Callable[[str], Any],
                 set_model: Callable[[Path], object]) -> None:
        """Know nothing of the twin yet.

        Args:
            store: of the versions.
            get: the value of a parameter.
            set_model: asks the twin to run a model file.
        """
        self.store, self.get, self.set_model = store, get, set_model
        self.runs: Mapping[str, Any] | None = None
        self._wanted = ''                  # SHA-256 of the champion's file
        self._asked: int | None = None     # when the twin was last asked to run it [ns]
        self._refused = ''                 # the version that it refused

    def informed(self, twins: Sequence[Mapping[str, Any]]) -> bool:
        """Hear what the twin runs; whether it is something else than before."""
        before, self.runs = self.runs, next((one for one in twins if not one.get('name')), None)
        return (before or {}).get('sha256') != (self.runs or {}).get('sha256')

    def want(self, champion: Version) -> None:
        """Take note of another champion."""
        self._wanted = source_of(champion.model_file).sha256
        self._asked = None

    def work(self, now: int, champion: Version | None) -> None:
        """Ask the twin to run the champion, and again if it does not; steady time in ns."""
        if champion is None or self.runs is None or self.get('policy') == OBSERVE:
            return
        if self.runs['sha256'] == self._wanted:
            self._asked, self._refused = None, ''
        elif self._refused != champion.name and (
                self._asked is None or now - self._asked > RETRY * SECOND):
            self._asked = now
            self.set_model(champion.model_file.absolute())

    def refused(self, champion: Version) -> bool:
        """Take note that the twin refuses something; whether that was the champion."""
        if self._asked is None:
            return False
        self._refused, self._asked = champion.name, None
        return True

    def first(self) -> Version | None:
        """Enter the model that the twin runs as the first champion; None before it is known.

        Raises:
            UserError: it cannot be read, or is not what the twin loaded.
        """
        runs = self.runs
        if runs is None:
            return None
        for version in self.store.versions():
            if source_of(version.model_file).sha256 == runs['sha256']:
                return self.store.promote(version.name, BY)
        path = Path(runs['path']).absolute()
        if source_of(path).sha256 != runs['sha256']:
            raise UserError(f'{path}: not the model that the twin runs any more')
        return self.store.promote(self.store.enter(path, f'{BY}: the twin ran it').name, BY)

    @property
    def trouble(self) -> str:
        """Say what is wrong with the twin, or ''."""
        if self.runs is None:
            return 'nothing is known of the twin'
        if self._wanted and self.runs['sha256'] != self._wanted:
            return f'the twin does not run the champion, but {self.runs["path"]}'
        return ''
