"""Shows the loop closing itself: a rig that wears, its twin, and `keep`, for `make loop`.

    python bags/loop.py out/loop

All three are processes, at 500 Hz of real time. The rig begins to rub once the twin has learned
its residual, and has play besides once the twin has learned that of the model with friction.
Writes loop.html and loop.json into the folder, and prints how long each took from its onset to
the model that names it.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
import contextlib
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String

from hydro_twin.files import write_whole
from hydro_twin.live.monitor import LEARN
from hydro_twin.report.history import Event, history_page, Story
from hydro_twin.ros.worn_rig import first_model, NOISE, STEP
from hydro_twin.store.history import courses, rows
from hydro_twin.store.store import Store

WATCHED = LEARN * STEP + 10.0   # what the twin learns from, and some quiet [s]
LONGEST = 1200.0                # for one of the two; a busy machine takes long [s]
LAST = 10.0                     # over which the residual is taken in the end [s]
WEAR = ('friction', 'backlash')
RELIABLE = [word for topic in ('command', 'joint_states') for policy, value in (
    ('reliability', 'reliable'), ('depth', 20_000)) for word in (
    '-p', f'qos_overrides./load_simulator/{topic}.subscription.{policy}:={value}')]


class Watcher:
    """Listens to the twin and to `keep`, and remembers when what was said."""

    def __init__(self) -> None:
        self.begin = time.monotonic()
        self.node = rclpy.create_node('story')
        self.squares: list[tuple[float, float]] = []
        self.events: list[tuple[float, dict[str, Any]]] = []
        self.node.create_subscription(JointState, '/hydro_twin/residual', self._residual,
                                      QoSProfile(depth=20_000))
        for topic in ('/hydro_twin_keep/event', '/hydro_twin/model_event'):
            self.node.create_subscription(String, topic, self._event, QoSProfile(depth=100))
        self.wear = self.node.create_publisher(Empty, '/wear', 10)

    @property
    def now(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.begin

    def _residual(self, message: JointState) -> None:
        self.squares.append((self.now, message.effort[0] ** 2))

    def _event(self, message: String) -> None:
        event = json.loads(message.data)
        self.events.append((self.now, event))
        print(f'{self.now:6.1f} s  {says(event)}', file=sys.stderr)

    def until(self, condition: Callable[[], bool], longest: float = LONGEST) -> None:
        """Listen until something is so."""
        end = self.now + longest
        while not condition():
            if self.now > end:
                sys.exit('it took too long; see the events above')
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def wait(self, seconds: float) -> None:
        """Listen for some time."""
        end = self.now + seconds
        self.until(lambda: self.now > end, seconds + 60.0)

    def promoted(self, name: str, since: float) -> float | None:
        """Say when a model that has an effect appear was promoted."""
        return next((at for at, event in self.events if at > since
                     and event['event'] == 'promoted' and name in event['changed']), None)

    def rms(self, since: float) -> float:
        """RMS of the residual from some time on."""
        return float(np.sqrt(np.mean([square for at, square in self.squares if at > since])))


def says(event: dict[str, Any]) -> str:
    """Tell an event in a few words."""
    about = {key: value for key, value in event.items() if key in (
        'version', 'changed', 'why', 'says', 'by', 'rms', 'reference_rms')}
    return f'{event["event"]}: ' + ', '.join(f'{key} {value}' for key, value in about.items())


@contextlib.contextmanager
def running(*words: str) -> Any:
    """Run a module of Python, and have it end."""
    with subprocess.Popen([sys.executable, '-m', *words]) as process:
        try:
            yield
        finally:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(20.0)
            process.kill()


def watch(folder: Path) -> tuple[Watcher, list[dict[str, Any]]]:
    """Run it; returns what was heard, and the figures of each kind of wear."""
    model, found = first_model(folder / 'first.yaml'), []
    rclpy.init()
    watcher = Watcher()
    verb = 'hydro_twin.commands.main'
    with (running('hydro_twin.ros.worn_rig'),
          running(verb, 'node', '--ros-args', '-p', f'model:={model}', '-p', 'mode:=free_run',
                  *RELIABLE),
          running(verb, 'keep', '--ros-args', '-p', f'store:={folder / "store"}', '-p',
                  'policy:=auto', '-p', 'before:=60.0', '-p', 'after:=20.0', '-p', 'nice:=0.0',
                  '-p', 'trial_least:=10.0', '-p', 'again:=60.0', *RELIABLE)):
        watcher.until(lambda: len(watcher.squares) > 0)
        for name in WEAR:
            watcher.wait(WATCHED)
            onset = watcher.now
            watcher.wear.publish(Empty())
            watcher.events.append((onset, {'event': 'onset', 'says': f'{name} begins'}))
            load = os.getloadavg()[0]
            watcher.until(lambda name=name, onset=onset: watcher.promoted(name, onset) is not None)
            at = watcher.promoted(name, onset) or 0.0
            watcher.until(lambda at=at: any(
                when > at and event['event'] == 'swapped' for when, event in watcher.events))
            watcher.wait(LAST + 5.0)
            found.append({'effect': name, 'seconds': at - onset,
                          'residual': watcher.rms(watcher.now - LAST), 'noise': NOISE,
                          'load': [load, os.getloadavg()[0]]})
            print(f'{name}: named after {at - onset:.0f} s; residual '
                  f'{found[-1]["residual"]:.3f} N m, noise {NOISE} N m; load {load:.1f} to '
                  f'{os.getloadavg()[0]:.1f}')
    return watcher, found


def main() -> int:
    """Run the demonstration; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('folder', type=Path, help='for the store, loop.html and loop.json')
    folder = parser.parse_args().folder
    shutil.rmtree(folder / 'store', ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    watcher, found = watch(folder)
    squares = np.array(watcher.squares)
    seconds = np.arange(int(squares[-1, 0]))
    residual = np.sqrt([np.mean(squares[(squares[:, 0] >= s) & (squares[:, 0] < s + 1), 1])
                        if np.any((squares[:, 0] >= s) & (squares[:, 0] < s + 1)) else np.nan
                        for s in seconds])
    heard = ~np.isnan(residual)
    store = Store.opened(folder / 'store')
    write_whole(folder / 'loop.html', history_page(
        'loop', rows(store), courses(store.versions()), Story(
            seconds[heard] + 0.5, residual[heard], NOISE, 'N m',
            tuple(Event(at, says(event)) for at, event in sorted(
                watcher.events, key=lambda one: one[0])))))
    write_whole(folder / 'loop.json', json.dumps(found, indent=2) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
