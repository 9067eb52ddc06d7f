"""A trace in processes of their own, with bounds on time, memory and their share of cores."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
from tempfile import TemporaryFile
from threading import Event
import time

import yaml

from hydro_twin.errors import UserError
from hydro_twin.files import write_whole
from hydro_twin.keep.capture import Captured, CONFIG, TRACE
from hydro_twin.model import read_model
from hydro_twin.recording.signals import SignalMap
from hydro_twin.store.version import MODEL, REGIMES

POLL = 0.2     # [s]
TAIL = 400     # characters of what a trace says that are passed on
MIB = 1 << 20


class TraceError(UserError):
    """A trace gave no model: one line says why."""


class NotEnoughError(TraceError):
    """A stretch says too little: one line says what is lacking, and which motion would show it."""


@dataclass(frozen=True)
class Bounds:
    """What a trace may use: time [s], memory of each of its processes [MiB], niceness."""

    time: float
    memory: float
    nice: float


def other_cores() -> list[int]:
    """List the cores that this process may use but for the first, or that one if it is alone."""
    cores = sorted(os.sched_getaffinity(0))
    return cores[1:] or cores


def trace(captured: Captured, champion: Path, earlier: Sequence[Path],
          signals: Mapping[str, SignalMap], mode: str, bounds: Bounds, stop: Event) -> Path:
    """Trace a captured stretch from the champion on, if it says enough.

    Then the new model is compared with the champion on the recordings, regime by regime.

    Args:
        captured: where report and model go, too.
        champion: model file to start from; the trace has its sample time and its constants.
        earlier: recordings that the champion came from.
        signals: where the signals are in the bag.
        mode: in which the models are compared.
        bounds: of the processes.
        stop: ends it early.

    Returns:
        The folder with model.yaml, report.json and regimes.json.

    Raises:
        NotEnoughError: the stretch moves the rig too little.
        TraceError: it failed, took too long, or was stopped.
        ModelError: the champion cannot be read.
        OSError: the folder cannot be written, or a process cannot be started.
    """
    model = read_model(champion)
    config, output = captured.folder / CONFIG, captured.folder / TRACE
    write_whole(config, yaml.safe_dump({'/**': {'ros__parameters': {
        'plant': model.plant.name, 'sample_time': model.sample_time,
        'signals': {name: asdict(where) for name, where in signals.items()},
        'constants': dict(model.constants)}}}, sort_keys=False))
    verbs = _Verbs(captured.folder, bounds, stop)
    rig = ['--model', str(champion), '--config', str(config)]
    judged = json.loads(verbs.run('excitation', str(captured.bag), *rig, '--json'))
    if not judged['enough']:
        raise NotEnoughError(judged['says'])
    known = list(earlier)

    def traced() -> None:
        """Trace with the earlier recordings that are known."""
        verbs.run('trace', str(captured.bag), '--plant', model.plant.name, *rig,
                  '-o', str(output), *(word for bag in known for word in ('--earlier', str(bag))))

    try:
        traced()
    except _BadInputError:
        if not known:
            raise
        known.clear()           # one may be of other topics
        traced()
    if not (output / MODEL).is_file():
        raise TraceError('the trace wrote no model')
    write_whole(output / REGIMES, verbs.run(
        'regimes', *map(str, [captured.bag, *known]), '--fitted', str(captured.bag), *rig,
        '--challenger', str(output / MODEL), '--mode', mode, '--json'))
    return output


class _BadInputError(TraceError):
    """A verb refused what it was given."""


class _Verbs:
    """Runs verbs one after another within one set of bounds; what they say is in trace.log."""

    def __init__(self, folder: Path, bounds: Bounds, stop: Event) -> None:
        self.log = folder / 'trace.log'
        self.log.unlink(missing_ok=True)
        self.bounds, self.stop = bounds, stop
        self.end = time.monotonic() + bounds.time

    def run(self, *words: str) -> bytes:
        """Run a verb to its end; returns what it printed.

        Raises:
            TraceError: it failed, there was no time left, or it was stopped.
        """
        spec = {'nice': self.bounds.nice, 'memory': int(self.bounds.memory * MIB),
                'cores': other_cores()}
        command = [sys.executable, '-m', 'hydro_twin.keep.confined', json.dumps(spec), *words]
        with (self.log.open('ab') as log, TemporaryFile() as out, subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=log,
                start_new_session=True, env={**os.environ, 'NO_COLOR': '1'}) as running):
            reason = self._wait(running)
            out.seek(0)
            printed = out.read()
            log.write(printed)
        if reason:
            raise TraceError(reason)
        if running.returncode:
            lines = [line for line in self.log.read_text('utf-8', 'replace').splitlines()
                     if line.strip()]
            kind = _BadInputError if running.returncode == 2 else TraceError
            raise kind(_last(lines, running.returncode))
        return printed

    def _wait(self, running: subprocess.Popen[bytes]) -> str:
        """Wait for a process; returns why it was ended, or ''."""
        while running.poll() is None:
            if time.monotonic() > self.end or self.stop.wait(POLL):
                os.killpg(running.pid, signal.SIGKILL)
                running.wait()
                return 'stopped' if self.stop.is_set() else (
                    f'took longer than {self.bounds.time:g} s')
        return ''


def _last(lines: list[str], status: int) -> str:
    """Say of a process that failed what it said last."""
    if status < 0:
        return f'ended by {signal.Signals(-status).name}'
    return lines[-1][-TAIL:] if lines else f'ended with status {status}'
