"""Kills `keep`, its tracer and the twin at random moments, and looks at the store after each.

    python benchmarks/kills.py [--kills 50]

A rig, its twin and `keep` (policy `auto`) run as processes. A capture is asked for again and
again, so that something is captured, traced or judged at most moments. After each kill, by
SIGKILL, the store must read whole, with every version and every capture that it had; the process
is started again as it was at first, the twin with the first model. In the end the twin must run
the champion.
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
import json
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

from rcl_interfaces.srv import GetParameters
import rclpy
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from hydro_twin.ros.worn_rig import first_model
from hydro_twin.store.store import Store

BETWEEN = 1.0, 15.0     # from one kill to the next [s]; a start takes some 4 s
ANSWER = 2.0            # of a service [s]
LONGEST = 300.0         # until the twin runs the champion in the end [s]
VERB = 'hydro_twin.commands.main'


class Processes:
    """The rig, the twin and `keep`."""

    def __init__(self, folder: Path) -> None:
        self.model = first_model(folder / 'first.yaml')
        self.store = folder / 'store'
        self.words: dict[str, Sequence[str]] = {
            'rig': ['hydro_twin.ros.worn_rig', '--faster', '2'],
            'node': [VERB, 'node', '--ros-args', '-p', f'model:={self.model}', '-p',
                     'mode:=free_run'],
            'keep': [VERB, 'keep', '--ros-args', '-p', f'store:={self.store}', '-p',
                     'policy:=auto', '-p', 'before:=20.0', '-p', 'after:=1.0', '-p', 'nice:=0.0',
                     '-p', 'trial_least:=1.0', '-p', 'captures:=1000.0']}
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        for name in self.words:
            self.start(name)

    def start(self, name: str) -> None:
        """Start one of them."""
        self.running[name] = subprocess.Popen(
            [sys.executable, '-m', *self.words[name]], stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL)

    def tracer(self) -> int | None:
        """Find the process of a trace."""
        keep = self.running['keep'].pid
        with contextlib.suppress(OSError):
            for pid in Path(f'/proc/{keep}/task/{keep}/children').read_text().split():
                return int(pid)
            for thread in Path(f'/proc/{keep}/task').iterdir():
                for pid in (thread / 'children').read_text().split():
                    return int(pid)
        return None

    def kill(self, name: str) -> bool:
        """Kill one of them, and start it again; whether it was there."""
        if name == 'tracer':
            pid = self.tracer()
            if pid is not None:
                with contextlib.suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            return pid is not None
        self.running[name].kill()
        self.running[name].wait()
        return True

    def end(self) -> None:
        """End all of them."""
        for process in self.running.values():
            process.kill()
            process.wait()


def state(store: Path) -> tuple[set[str], set[str]]:
    """Read all of a store: its versions with their models, and its captures."""
    found = Store(store)
    versions = found.versions()
    for version in versions:
        version.model()
    champion = found.champion
    if versions and champion is not None:
        champion.model()
    captures = {path.name for path in (store / 'captures').glob('[0-9]*')}
    for name in captures:
        assert (store / 'captures' / name / 'bag' / 'metadata.yaml').is_file(), name
    return {version.name for version in versions}, captures


def ask(node: Any, client: Any, request: Any) -> Any:
    """Call a service; None where it does not answer."""
    if not client.wait_for_service(ANSWER):
        return None
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=ANSWER)
    return future.result()


def main() -> None:
    """Run it, and print one JSON object."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--kills', type=int, default=50)
    kills, rng = parser.parse_args().kills, random.Random(0)
    done = dict.fromkeys(('keep', 'tracer', 'node'), 0)
    rclpy.init()
    node = rclpy.create_node('kills')
    capture = node.create_client(Trigger, '/hydro_twin_keep/capture')
    get = node.create_client(GetParameters, '/hydro_twin/get_parameters')
    wear = node.create_publisher(Empty, '/wear', 10)
    with TemporaryDirectory() as folder:
        processes = Processes(Path(folder))
        try:
            versions, captures = state(processes.store)
            while sum(done.values()) < kills:
                end = time.monotonic() + rng.uniform(*BETWEEN)
                while time.monotonic() < end:
                    ask(node, capture, Trigger.Request())
                    time.sleep(0.5)
                if versions:
                    wear.publish(Empty())
                name = rng.choice(list(done))
                done[name] += processes.kill(name)
                print(f'{sum(done.values())} of {kills}: {name}', file=sys.stderr, flush=True)
                before = versions, captures
                versions, captures = state(processes.store)
                assert versions >= before[0], 'a version is lost'
                assert captures >= before[1], 'a capture is lost'
                if name != 'tracer':
                    processes.start(name)
            runs, end = '', time.monotonic() + LONGEST
            while time.monotonic() < end:
                champion = Store(processes.store).champion
                answer = ask(node, get, GetParameters.Request(names=['model']))
                runs = answer.values[0].string_value if answer else ''
                if champion is not None and runs == str(champion.model_file):
                    break
            else:
                raise AssertionError(f'the twin runs {runs}')
            print(json.dumps({'killed': done, 'versions': len(versions),
                              'captures': len(captures), 'champion': champion.name,
                              'load': os.getloadavg()[0]}))
        finally:
            processes.end()
            rclpy.try_shutdown()


if __name__ == '__main__':
    main()
