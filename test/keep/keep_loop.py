"""What the tests of the loop share: a keeper, with a twin and a trace that are made up."""
from __future__ import annotations

from dataclasses import asdict
import json
from pathlib import Path
import shutil
import time

import pytest
from rosbags.typesys import get_typestore, Stores
from store_models import write

from hydro_twin.keep import keeper as module
from hydro_twin.keep.keeper import Keeper
from hydro_twin.keep.regimes import Known
from hydro_twin.keep.ring import SECOND
from hydro_twin.keep.settings import SETTINGS
from hydro_twin.keep.tracing import NotEnoughError, TraceError
from hydro_twin.recording.digest import source_of
from hydro_twin.store.store import Store

STORE = get_typestore(Stores.ROS2_JAZZY)
STRING = 'std_msgs/msg/String'
FRICTION = [('friction', 'motor', {'coulomb': (10.0, 0.1)})]


class Loop:
    """A keeper with a twin that runs whatever it is asked to, and a trace that finds friction."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, **values: object) -> None:
        self.folder = folder
        self.values = {s.name: s.default for s in SETTINGS} | {
            'after': 5.0, 'policy': 'auto', 'trial_least': 0.0, 'trial': 60.0} | values
        self.announced: list[tuple[str, dict[str, object]]] = []
        self.asked: list[Path] = []
        self.refusal = self.lacks = ''
        self.earlier: list[list[Path]] = []
        self.known: Known | None = None     # of the regimes
        self.finds: Path | None = write(folder / 'found.yaml', FRICTION)
        self.now = 1000 * SECOND
        self.first = write(folder / 'first.yaml')
        self.monkeypatch = monkeypatch
        monkeypatch.setattr(module, 'trace', self._trace)
        self.start()
        self.runs(self.first)

    def start(self) -> None:
        self.keeper = Keeper(Store(self.folder / 'store'), self.values.__getitem__,
                             lambda event, **about: self.announced.append((event, about)),
                             self.asked.append)
        self.keeper.topics['/a'] = STRING, False
        self.keeper.signals = {'u_m': None}

    def runs(self, path: Path) -> None:
        self.keeper.informed([{'name': '', 'path': str(path), 'mode': 'free_run',
                               'sha256': source_of(path).sha256}])

    def _trace(self, captured, champion, earlier, signals, mode, bounds, stop) -> Path:
        assert mode == 'free_run'
        self.earlier.append(earlier)
        if self.lacks:
            raise NotEnoughError(self.lacks)
        if self.finds is None:
            raise TraceError('it holds no 3 samples in a row')
        shutil.copy(self.finds, captured.folder / 'model.yaml')
        if self.known is not None:
            (captured.folder / 'regimes.json').write_text(json.dumps(asdict(self.known)))
        return captured.folder

    def tick(self, seconds: float = 1.0) -> None:
        """Let some time pass, with a message a second and a twin that obeys."""
        for _ in range(round(seconds)):
            self.now += SECOND
            self.keeper.ring.add('/a', self.now, self.now, STORE.serialize_cdr(
                STORE.types[STRING]('x'), STRING))
            self.keeper.tick(self.now)
            while self.asked:
                path = self.asked.pop()
                if self.refusal:
                    self.keeper.answered(self.refusal)
                else:
                    self.runs(path)

    def until(self, condition) -> None:
        """Tick until something is so; jobs are threads, which take their time."""
        end = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < end, (self.said(), self.announced)
            self.tick()
            time.sleep(0.01)

    def events(self) -> list[str]:
        return [event for event, _ in self.announced]

    def said(self) -> str:
        return self.keeper.status(self.now).message

    def judged(self, champion: float, other: float, seconds: float = 30.0) -> None:
        """Wait for a duel, and give it squared residuals."""
        self.until(lambda: self.keeper.judge.duel is not None)
        for k in range(round(seconds * 500)):
            self.keeper.judge.duel.take(champion * (1 + k % 3), other * (1 + k % 3))
        self.tick()

    def champion(self) -> str:
        return self.keeper.store.champion.name
