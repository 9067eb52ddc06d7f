"""A trace as a process of its own: limits that hold, failures that are one line."""
from __future__ import annotations

from collections.abc import Callable
import contextlib
import json
import os
from pathlib import Path
import subprocess
import sys
from threading import Event, Timer
import time

import numpy as np
import pytest
from store_models import write

from hydro_twin.commands.main import main
from hydro_twin.keep.capture import Captured
from hydro_twin.keep.tracing import Bounds, NotEnoughError, other_cores, trace, TraceError
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording

ROOT = Path(__file__).resolve().parents[2]
SIGNALS = load_signals('load_simulator',
                       [signal.name for signal in plant_named('load_simulator').signals])


def captured(folder: Path, bag: Path) -> Captured:
    folder.mkdir()
    (folder / 'bag').symlink_to(bag)
    return Captured(folder, '0')


def test_the_limits_are_those_of_the_process_that_traces(tmp_path: Path) -> None:
    """Measured by the process itself, in the place of the verb."""
    package = tmp_path / 'hydro_twin'
    (package / 'commands').mkdir(parents=True)
    (package / 'keep').mkdir()
    for folder in (package, package / 'commands', package / 'keep'):
        (folder / '__init__.py').touch()
    (package / 'keep' / 'confined.py').write_text(
        (ROOT / 'hydro_twin' / 'keep' / 'confined.py').read_text())
    (package / 'commands' / 'main.py').write_text(
        'import json, os, resource, sys\n'
        'print(json.dumps([os.nice(0), resource.getrlimit(resource.RLIMIT_AS)[0],\n'
        '                  sorted(os.sched_getaffinity(0)), sys.argv[1:]]))\n')
    spec = {'nice': 19, 'memory': 1 << 32, 'cores': other_cores()}
    done = subprocess.run(
        [sys.executable, '-m', 'hydro_twin.keep.confined', json.dumps(spec), 'trace', 'BAG'],
        capture_output=True, text=True, check=True, cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': str(tmp_path)})
    assert json.loads(done.stdout) == [19, 1 << 32, other_cores(), ['trace', 'BAG']]
    cores = sorted(os.sched_getaffinity(0))
    assert other_cores() == (cores[1:] or cores)


@pytest.mark.parametrize(('bounds', 'stop', 'says'), [
    (Bounds(600.0, 8192.0, 0), 0.0, r'holds no .*samples|no such bag'),
    (Bounds(0.5, 8192.0, 0), 0.0, 'took longer than 0.5 s'),
    (Bounds(600.0, 8192.0, 0), 0.3, 'stopped'),
    (Bounds(600.0, 60.0, 0), 0.0, r'.'),
])
def test_what_goes_wrong_is_one_line(tmp_path: Path, bounds: Bounds, stop: float,
                                     says: str) -> None:
    model = write(tmp_path / 'model.yaml')
    bag = ROOT / 'bags' / ('absent' if 'holds' in says else 'rig_a')
    ended = Event()
    if stop:
        Timer(stop, ended.set).start()
    with pytest.raises(TraceError, match=says) as raised:
        trace(captured(tmp_path / 'captured', bag), model, [], SIGNALS, 'free_run', bounds, ended)
    assert '\n' not in str(raised.value)
    assert str(raised.value)


@pytest.mark.slow
def test_a_stretch_at_rest_is_not_traced(tmp_path: Path) -> None:
    bag = tmp_path / 'still'
    write_recording(bag, [Series({name: np.zeros(1000) for name in SIGNALS}, 0.002)], SIGNALS)
    there = captured(tmp_path / 'captured', bag)
    with pytest.raises(NotEnoughError, match='T_g never moves in the recording'):
        trace(there, write(tmp_path / 'model.yaml'), [], SIGNALS, 'free_run',
              Bounds(600.0, 8192.0, 0), Event())
    assert not (there.folder / 'trace').exists()


@pytest.mark.slow
def test_an_earlier_recording_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    assert main(['simulate', '--plant', 'load_simulator', '--duration', '2', '--noise', '0.5',
                 '-o', str(tmp_path / 'bag')]) == 0
    there = captured(tmp_path / 'captured', tmp_path / 'bag')
    found = trace(there, write(tmp_path / 'model.yaml'), [tmp_path / 'gone'], SIGNALS,
                  'free_run', Bounds(600.0, 8192.0, 0), Event())
    assert json.loads((found / 'report.json').read_text())['memory'] is None
    assert 'gone' in (there.folder / 'trace.log').read_text()
    regimes = json.loads((found / 'regimes.json').read_text())
    assert regimes['mode'] == 'free_run'
    assert regimes['holds'] == {}      # no recording but the one that the model was made from


def test_a_trace_ends_with_the_node_even_where_that_is_killed(tmp_path: Path) -> None:
    code = ('import sys\nfrom pathlib import Path\nfrom threading import Event\n'
            'from hydro_twin.keep.capture import Captured\n'
            'from hydro_twin.keep.tracing import Bounds, trace\n'
            'trace(Captured(Path(sys.argv[1]), "0"), Path(sys.argv[2]), [], {}, '
            '"free_run", Bounds(600.0, 8192.0, 0), Event())\n')
    there = captured(tmp_path / 'captured', ROOT / 'bags' / 'rig_a')
    model = write(tmp_path / 'model.yaml')
    with subprocess.Popen([sys.executable, '-c', code, str(there.folder), str(model)]) as node:
        children = Path(f'/proc/{node.pid}/task/{node.pid}/children')

        def tracing() -> list[Path]:
            """List the processes that have become the verb."""
            return [Path('/proc') / pid for pid in children.read_text().split()
                    if b'commands.main' in Path('/proc', pid, 'cmdline').read_bytes()]

        until(lambda: bool(tracing()))
        (child,) = tracing()
        node.kill()
        node.wait()
    until(lambda: not child.exists() or ' Z ' in (child / 'stat').read_text())
    assert not child.exists() or ' Z ' in (child / 'stat').read_text()


def until(condition: Callable[[], bool]) -> None:
    """Wait for something that comes in no time, but on a busy machine."""
    end = time.monotonic() + 120.0
    while time.monotonic() < end:
        with contextlib.suppress(OSError):
            if condition():
                return
        time.sleep(0.02)
    pytest.fail('waited in vain')
