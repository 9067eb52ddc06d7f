"""A trace in a process of its own, with bounds on its time, its memory and its share of cores."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
from threading import Event
import time

import yaml

from hydro_twin.errors import UserError
from hydro_twin.files import write_whole
from hydro_twin.keep.capture import Captured, CONFIG, TRACE
from hydro_twin.model import read_model
from hydro_twin.recording.signals import SignalMap
from hydro_twin.store.version import MODEL

POLL = 0.2     # [s]
TAIL = 400     # characters of what a trace says that are passed on
MIB = 1 << 20


class TraceError(UserError):
    """A trace gave no model: one line says why."""


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


def trace(captured: Captured, champion: Path, signals: Mapping[str, SignalMap], bounds: Bounds,
          stop: Event) -> Path:
    """Trace a captured stretch from the champion on.

    Args:
        captured: where report and model go, too.
        champion: model file to start from; the trace has its sample time and its constants.
        signals: where the signals are in the bag.
        bounds: of the process.
        stop: ends it early.

    Returns:
        The folder with model.yaml and report.json.

    Raises:
        TraceError: it failed, took too long, or was stopped.
        ModelError: the champion cannot be read.
    """
    model = read_model(champion)
    config, output = captured.folder / CONFIG, captured.folder / TRACE
    write_whole(config, yaml.safe_dump({'/**': {'ros__parameters': {
        'plant': model.plant.name, 'sample_time': model.sample_time,
        'signals': {name: asdict(where) for name, where in signals.items()},
        'constants': dict(model.constants)}}}, sort_keys=False))
    spec = {'nice': bounds.nice, 'memory': int(bounds.memory * MIB), 'cores': other_cores()}
    command = [sys.executable, '-m', 'hydro_twin.keep.confined', json.dumps(spec), 'trace',
               str(captured.bag), '--plant', model.plant.name, '--model', str(champion),
               '--config', str(config), '-o', str(output)]
    said = captured.folder / 'trace.log'
    with said.open('wb') as log, subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
            start_new_session=True, env={**os.environ, 'NO_COLOR': '1'}) as running:
        reason = _wait(running, bounds.time, stop)
    if reason:
        raise TraceError(reason)
    if running.returncode:
        lines = [line for line in said.read_text('utf-8', 'replace').splitlines() if line.strip()]
        raise TraceError(_last(lines, running.returncode))
    if not (output / MODEL).is_file():
        raise TraceError('the trace wrote no model')
    return output


def _wait(running: subprocess.Popen[bytes], longest: float, stop: Event) -> str:
    """Wait for a process; returns why it was ended, or ''."""
    end = time.monotonic() + longest
    while running.poll() is None:
        if time.monotonic() > end or stop.wait(POLL):
            os.killpg(running.pid, signal.SIGKILL)
            running.wait()
            return 'stopped' if stop.is_set() else f'took longer than {longest:g} s'
    return ''


def _last(lines: list[str], status: int) -> str:
    """Say of a process that failed what it said last."""
    if status < 0:
        return f'ended by {signal.Signals(-status).name}'
    return lines[-1][-TAIL:] if lines else f'ended with status {status}'
