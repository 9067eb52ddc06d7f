"""The node and the player as real processes over DDS."""
from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

from hydro_twin.model import Estimate, Model, write_model
from hydro_twin.plants import plant_named
from hydro_twin.predictors.predictor import load
from hydro_twin.recording.read import read_recording
from hydro_twin.recording.series import Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

pytestmark = [pytest.mark.slow,   # what rclpy imports imports what is out of date
              pytest.mark.filterwarnings("ignore:module 'sre_")]

PLANT = plant_named('load_simulator')
NAMES = [s.name for s in PLANT.signals]
START = 1_700_000_000_123_456_789
STEP = 2_000_000
INPUTS = ('/load_simulator/command', '/load_simulator/joint_states')
RELIABLE = {f'qos_overrides.{topic}.subscription.{policy}': value for topic in INPUTS
            for policy, value in (('reliability', 'reliable'), ('depth', 5000))}
PATIENCE = 20.0   # s; nothing here is timed, this only ends a test that hangs


@pytest.fixture(scope='module', autouse=True)
def _domain() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        patch.setenv('ROS_DOMAIN_ID', str(os.getpid() % 100 + 1))
        rclpy.init(args=[])
        yield
        rclpy.try_shutdown()


def make_model(path: Path, **changes: float) -> Path:
    values = {p.name: (p.lower * p.upper)**0.5 for p in PLANT.parameters} | changes
    write_model(Model(PLANT, {n: Estimate(v) for n, v in values.items()},
                      PLANT.constant_values(), PLANT.sample_time,
                      errors={'after': {m: {'test': 3.0} for m in ('one_step', 'free_run')}}),
                path)
    return path


def make_series(samples: int, start: int = START) -> Series:
    time_ = np.arange(samples) * 0.002
    rng = np.random.default_rng(3)
    return Series({'u_m': np.sin(2 * np.pi * 7 * time_), 'theta_d': 0.01 * np.sin(9 * time_),
                   'T_g': 30 * np.sin(2 * np.pi * 7 * time_ - 1) + rng.normal(size=samples)},
                  0.002, start)


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_model(tmp_path_factory.mktemp('models') / 'linear.yaml')


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two stretches with a pause, the second long enough for the network to hiccup."""
    path = tmp_path_factory.mktemp('bags') / 'bag'
    write_recording(path, [make_series(500), make_series(1000, START + 1700 * STEP)],
                    load_signals('load_simulator', NAMES))
    return path


class Rig:
    """The test's own node, which listens, asks and drives."""

    def __init__(self) -> None:
        self.node = rclpy.create_node('rig')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.heard: dict[str, list[Any]] = {}

    def listen(self, topic: str, kind: Any, latched: bool = False) -> list[Any]:
        heard = self.heard.setdefault(topic, [])
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        self.node.create_subscription(kind, topic, heard.append,
                                      QoSProfile(depth=5000, durability=durability))
        return heard

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if found := condition():
                return found
            self.executor.spin_once(timeout_sec=0.02)
        pytest.fail(f'waited in vain until {what}')

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f'{name} is there')
        future = client.call_async(request)
        self.until(future.done, f'{name} answers')
        self.node.destroy_client(client)
        return future.result()

    def status(self, part: str, text: str) -> Any:
        """Wait until the node says something of one of its parts."""
        heard = self.heard['/diagnostics']
        return self.until(lambda: next(
            (s for m in heard for s in m.status if s.name.endswith(part) and text in s.message),
            None), f'{part} says {text!r}, not {[s.message for m in heard for s in m.status]}')

    def ready(self) -> None:
        """Wait until the node listens to the inputs, and all who shall hear it have found it."""
        for topic in INPUTS:
            self.until(lambda t=topic: self.node.count_subscribers(t), f'{topic} has a listener')
        for topic in self.heard:
            self.until(lambda t=topic: self.node.count_publishers(t), f'{topic} has a publisher')
        self.status('time', '')   # its diagnostics arrive, so discovery is through


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    made.listen('/diagnostics', DiagnosticArray)
    yield made
    made.node.destroy_node()


@contextlib.contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen([sys.executable, '-m', *arguments], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True) as running:
        try:
            yield running
        finally:
            running.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                running.wait(10)
            running.kill()


@contextlib.contextmanager
def twin(**parameters: object) -> Iterator[subprocess.Popen[str]]:
    flags = [word for name, value in parameters.items()
             for word in ('-p', f'{name}:={value}')]
    with process('hydro_twin.node', '--ros-args', *flags) as running:
        yield running


def play(bag: Path, *flags: str) -> None:
    subprocess.run([sys.executable, '-m', 'hydro_twin.commands.main', 'replay', str(bag),
                    '--publish', *flags], check=True, timeout=120, stdout=subprocess.DEVNULL)


def stamp_of(message: JointState) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


@pytest.mark.parametrize('mode', ['one_step', 'free_run'])
@pytest.mark.parametrize('rate', [1.0, 4.0])
def test_live_is_replay_to_the_last_digit(rig: Rig, bag: Path, model: Path, mode: str,
                                          rate: float) -> None:
    predictions = rig.listen('/hydro_twin/prediction', JointState)
    residuals = rig.listen('/hydro_twin/residual', JointState)
    predictor = load(model)
    recording = read_recording([bag], load_signals('load_simulator', NAMES), ['u_m'], 0.002)
    expected = {series.start + k * STEP: (y, series['T_g'][k] - y)
                for series in recording.series
                for k, y in enumerate(getattr(predictor, mode)(series).tolist()) if y == y}
    assert len(recording.series) == 2
    with twin(model=model, mode=mode, **RELIABLE):
        rig.ready()
        play(bag, '--rate', str(rate))
        rig.until(lambda: len(residuals) >= len(expected), 'all is predicted')
    assert [stamp_of(m) for m in predictions] == list(expected)
    assert [m.effort[0] for m in predictions] == [y for y, _ in expected.values()]
    assert [m.effort[0] for m in residuals] == [e for _, e in expected.values()]
