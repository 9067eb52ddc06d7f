"""The node and the player as real processes over DDS."""
from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from itertools import pairwise
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rcl_interfaces.srv import GetParameters, SetParameters  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from hydro_twin.model import Estimate, Model, write_model  # noqa: E402
from hydro_twin.plants import plant_named  # noqa: E402
from hydro_twin.predictors.predictor import load  # noqa: E402
from hydro_twin.recording.read import read_recording  # noqa: E402
from hydro_twin.recording.series import Series  # noqa: E402
from hydro_twin.recording.signals import load_signals  # noqa: E402
from hydro_twin.recording.write import write_recording  # noqa: E402

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


def set_parameter(rig: Rig, name: str, value: object) -> Any:
    return rig.call(SetParameters, '/hydro_twin/set_parameters', SetParameters.Request(
        parameters=[Parameter(name, value=value).to_parameter_msg()])).results[0]


def events(heard: list[String]) -> list[dict[str, Any]]:
    return [json.loads(message.data) for message in heard]


def test_models_run_side_by_side_and_are_exchanged_or_refused_while_they_run(
        rig: Rig, tmp_path: Path, bag: Path) -> None:
    first = make_model(tmp_path / 'first.yaml')
    stiff = make_model(tmp_path / 'stiff.yaml', G=1.4e4)
    broken = tmp_path / 'broken.yaml'
    broken.write_text(first.read_text().replace('J:', 'JJ:'))
    info = rig.listen('/hydro_twin/model_info', String, latched=True)
    happened = rig.listen('/hydro_twin/model_event', String)
    mains = rig.listen('/hydro_twin/prediction', JointState)
    stiffs = rig.listen('/hydro_twin/stiff/prediction', JointState)
    with twin(model=first, models=f'[{stiff}]', mode='free_run', **RELIABLE):
        rig.ready()
        described = json.loads(rig.until(lambda: info, 'the models are described')[-1].data)
        assert [(d['name'], d['plant'], len(d['sha256'])) for d in described] == \
            [('', 'load_simulator', 64), ('stiff', 'load_simulator', 64)]
        with process('hydro_twin.commands.main', 'replay', str(bag), '--publish', '--loop'):
            rig.until(lambda: len(mains) > 100, 'something is predicted')

            refused = set_parameter(rig, 'model', str(tmp_path / 'absent.yaml'))
            assert not refused.successful
            assert 'No such file' in refused.reason
            assert not set_parameter(rig, 'mode', 'two_step').successful
            assert not set_parameter(rig, 'models', ['x.yaml']).successful

            assert set_parameter(rig, 'model', str(broken)).successful   # it looks like a model
            rig.until(lambda: [e for e in events(happened) if e['event'] == 'refused'],
                      'the broken model is refused')
            rig.until(lambda: rig.call(
                GetParameters, '/hydro_twin/get_parameters',
                GetParameters.Request(names=['model'])).values[0].string_value == str(first),
                'the parameter is what it was')
            first.unlink()   # the file of the running model vanishes
            count = len(mains)
            rig.until(lambda: len(mains) > count + 100, 'the old model still runs')

            assert set_parameter(rig, 'model', str(stiff)).successful
            rig.until(lambda: [e for e in events(happened) if e['event'] == 'swapped'],
                      'the other model takes over')
            mains.clear()
            stiffs.clear()
            # Once the bag has begun anew, both have run on the same samples from one start.
            rig.until(lambda: [m for m in mains if stamp_of(m) == START], 'the bag begins anew')
            begun = next(k for k, m in enumerate(mains) if stamp_of(m) == START)
            rig.until(lambda: len(mains) > begun + 400 and len(stiffs) > 400, 'more comes')
            twins = {stamp_of(m): m.effort[0] for m in stiffs}
            shared = [(m.effort[0], twins[stamp_of(m)]) for m in mains[begun:begun + 300]
                      if stamp_of(m) in twins]
            assert len(shared) > 200
            assert all(main == stiff for main, stiff in shared)


def test_the_node_obeys_a_lifecycle_manager_and_resets(rig: Rig, model: Path, bag: Path) -> None:
    predictions = rig.listen('/hydro_twin/prediction', JointState)

    def state() -> str:
        return rig.call(GetState, '/hydro_twin/get_state', GetState.Request()).current_state.label

    def change(label: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = label
        return rig.call(ChangeState, '/hydro_twin/change_state', request).success

    with twin(model=model.with_name('absent.yaml'), autostart=False):
        assert state() == 'unconfigured'
        assert not change('configure')
        assert state() == 'unconfigured'
        assert set_parameter(rig, 'model', str(model)).successful
        assert change('configure')
        assert state() == 'inactive'
        assert change('activate')
        for _ in range(2):
            rig.ready()
            predictions.clear()
            play(bag, '--rate', '4')
            rig.until(lambda: len(predictions) > 1000, 'it predicts')
            assert change('deactivate')
            assert change('activate')
        reset = rig.call(Trigger, '/hydro_twin/reset', Trigger.Request())
        assert reset.success
        assert change('deactivate')
        assert change('cleanup')
        assert state() == 'unconfigured'


def test_played_with_a_clock_in_a_loop_it_resets_at_the_jump(rig: Rig, bag: Path, model: Path,
                                                             ) -> None:
    predictions = rig.listen('/hydro_twin/prediction', JointState)
    with twin(model=model, mode='free_run', use_sim_time=True, **RELIABLE):
        rig.until(lambda: rig.node.count_subscribers('/clock'), 'the clock has a listener')
        with process('hydro_twin.commands.main', 'replay', str(bag), '--publish', '--loop',
                     '--clock', '--rate', '4'):
            rig.status('time', 'jumped back')
            rig.until(lambda: len(predictions) > 3500, 'it goes on')
    stamps = [stamp_of(m) for m in predictions]
    assert max(stamps) < START + 3000 * STEP
    assert sum(later < earlier for earlier, later in pairwise(stamps)) >= 1


def test_a_bad_start_is_one_line(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'hydro_twin.commands.main', 'node', '--ros-args', '-p',
         f'model:={tmp_path / "absent.yaml"}', '--log-level', 'fatal'],
        capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.count('\n') == 1
    assert 'absent.yaml' in done.stderr
