"""The models that a node runs: a thread loads others, and the next message swaps them in."""
from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock

from rclpy.impl.rcutils_logger import RcutilsLogger

from hydro_twin.errors import ModelError
from hydro_twin.live.diagnostics import Diagnosis
from hydro_twin.live.models import check_same_inputs, Choice, load_twin, same_file
from hydro_twin.live.outlet import Outlet
from hydro_twin.live.twin import Twin
from hydro_twin.ros.announcer import Announcer


@dataclass(frozen=True)
class Settings:
    """Which models run, and how: those of the node's parameters.

    Attributes:
        chosen: the models, the main one first, if there is one.
        mode: as asked for; a model that cannot run in it runs in another.
        follow: parameters that the observers follow, NAME or NAME=RATE.
    """

    chosen: tuple[Choice, ...]
    mode: str
    follow: tuple[str, ...]

    @property
    def main(self) -> Choice:
        """The first model; one without a name can be exchanged."""
        return self.chosen[0]


@dataclass(frozen=True)
class _Request:
    """Settings that were asked for, and the diagnosis of what ran then."""

    diagnosis: Diagnosis
    settings: Settings


class RunningModels:
    """What runs, what is to take over, and what was refused.

    The executor asks and swaps, a thread loads. They meet in attributes that are set whole.
    """

    def __init__(self, announcer: Announcer, logger: RcutilsLogger) -> None:
        """Tell of exchanges on the topics of a node, and in its log."""
        self._announcer, self._logger = announcer, logger
        self._settings: Settings | None = None
        self.waiting: deque[Twin] = deque()       # loaded, to take over at the next message
        self._asked: _Request | None = None       # the newest request
        self._refused: _Request | None = None     # the last that was refused
        self._lock = Lock()     # held while models take over, or are forgotten
        self.diagnosis: Diagnosis | None = None   # of what runs; None: nothing does

    @property
    def settings(self) -> Settings:
        """What runs, or ran last.

        Raises:
            RuntimeError: nothing has run yet.
        """
        if self._settings is None:
            raise RuntimeError('no models are loaded')
        return self._settings

    def load(self, settings: Settings) -> list[Twin]:
        """Load models, and say which of them cannot run in the mode.

        Raises:
            ModelError: one cannot be used.
        """
        twins = [load_twin(choice, settings.mode, settings.follow) for choice in settings.chosen]
        for choice, twin in zip(settings.chosen, twins, strict=True):
            if twin.mode != settings.mode:
                self._logger.warning(
                    f'{choice.path} has no section `{settings.mode}`, so it runs {twin.mode}: '
                    '`refit` and `trace` write one for analytical models')
        return twins

    def begin(self, settings: Settings, diagnosis: Diagnosis) -> None:
        """Run models that were loaded."""
        self._settings, self.diagnosis = settings, diagnosis

    def forget(self) -> None:
        """Run nothing any more, and drop what is being loaded."""
        self._asked = self._refused = None
        with self._lock:
            self.diagnosis = None
            self.waiting.clear()

    def file_changed(self) -> bool:
        """Say whether the file of the main model is another than the one that runs."""
        return (self.diagnosis is not None
                and not same_file(self.settings.main.path, self.diagnosis.twins[0]))

    def ask(self, model: str, mode: str, follow: Sequence[str]) -> Callable[[], None] | None:
        """Ask for other settings: return what a thread is to do for them, None if nothing runs.

        The model takes the place of the main one, if there is one.
        """
        if self.diagnosis is None:
            return None
        first, *others = self.settings.chosen
        main = first if first.name else Choice('', Path(model).expanduser())
        self._asked = _Request(self.diagnosis, Settings((main, *others), mode, tuple(follow)))
        return partial(self._reload, self._asked)

    def refused(self) -> bool:
        """Say, once, that the newest request was refused.

        Of an older one nothing is said: a newer one may be granted.
        """
        refused, self._refused = self._refused, None
        return refused is not None and refused is self._asked

    def swap_in(self, outlets: Sequence[Outlet]) -> None:
        """Let freshly loaded twins take over, between two samples."""
        while self.waiting:
            twin = self.waiting.popleft()
            for outlet in outlets:
                if outlet.twin.name == twin.name:
                    outlet.exchange(twin)

    def _reload(self, asked: _Request) -> None:
        """Load what has changed to take over from what runs, or leave that running."""
        diagnosis, settings = asked.diagnosis, asked.settings
        if self.diagnosis is not diagnosis:
            return   # cleaned up meanwhile
        now = self.settings
        everywhere = (settings.mode, settings.follow) != (now.mode, now.follow)
        try:
            twins = self.load(settings if everywhere else
                              replace(settings, chosen=(settings.main,)))
            check_same_inputs(twins[0], diagnosis.twins[0])
        except ModelError as error:
            if self.diagnosis is diagnosis:
                self._logger.error(f'refused, the model before it still runs: {error}')
                self._announcer.event('refused', says=str(error))
                self._refused = asked
            return
        with self._lock:
            if self.diagnosis is not diagnosis:
                return   # cleaned up while it was loaded, which takes seconds
            self._settings = settings
            self.waiting.extend(twins)
            diagnosis.replace(twins)
        self._announcer.info(diagnosis.twins)
        self._announcer.event('swapped', model=str(settings.main.path), mode=twins[0].mode)
        self._logger.info(f'{settings.main.path} takes over, {twins[0].mode}')
