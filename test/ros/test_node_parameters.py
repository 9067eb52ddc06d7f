"""The parameters of the node, in this process and without a model: nothing here predicts."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
from functools import partial
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.clock import ROSClock  # noqa: E402,I100
from rclpy.parameter import Parameter  # noqa: E402,I100
from rclpy.time import Time  # noqa: E402
from ros_rig import running_node  # noqa: E402

from hydro_twin.errors import UserError  # noqa: E402
from hydro_twin.model import Model, Noise, write_model  # noqa: E402
from hydro_twin.plants import plant_named  # noqa: E402
from hydro_twin.ros.node import TwinNode  # noqa: E402

# What rclpy imports imports what is out of date.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_")

running = partial(running_node, TwinNode)


def set_(node: TwinNode, name: str, value: Any) -> Any:
    """Set a parameter as the service of the node does."""
    return node.set_parameters_atomically([Parameter(name, value=value)])


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return write(tmp_path, 'load_simulator')


def write(folder: Path, name: str) -> Path:
    plant = plant_named(name)
    values = {p.name: (p.lower + p.upper) / 2 for p in plant.parameters}
    path = folder / f'{name}.yaml'
    write_model(Model(plant, plant.constant_values() | values, plant.sample_time), path)
    return path


def test_signals_can_be_set_before_the_node_is_configured(model: Path) -> None:
    with running('-p', f'model:={model}') as node:
        assert set_(node, 'signals.u_m.topic', '/my/command').successful
        assert node.get_parameter('signals.u_m.topic').value == '/my/command'
        refused = set_(node, 'signals.u_n.topic', '/my/command')
        assert not refused.successful
        assert 'u_m, theta_d, T_g' in refused.reason
        other = write(model.parent, 'cylinder')
        assert set_(node, 'model', str(other)).successful
        assert set_(node, 'signals.x.topic', '/my/piston').successful
        assert not node.has_parameter('signals.u_m.topic')


def test_what_is_refused_once_it_is_loaded_goes_back_to_what_runs(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else every later model would be refused for it, too."""
    plant = plant_named('cylinder')
    path = tmp_path / 'model.yaml'
    write_model(Model(plant, plant.middle(), plant.sample_time, noise=Noise(
        1e-5, {'q': 1e-4, 'x': 1e-4}, {'q': 0.1, 'x': 0.1})), path)
    with running('-p', f'model:={path}', '-p', 'follow:=[tau]') as node:
        node.start()
        node._worker.stop()
        monkeypatch.setattr(node._worker, 'do', lambda job: job())   # at once
        for value in (['Kv'], ['tau', 'K_v']):
            assert set_(node, 'follow', value).successful
            node._restore()
            assert node.get_parameter('follow').value == (['tau'] if 'Kv' in value else value)
            assert node.get_parameter('mode').value == 'observer'


@contextlib.contextmanager
def by_hand(model: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str,
            ) -> Iterator[tuple[TwinNode, list[Any]]]:
    """Make an active node, and collect the jobs of its thread instead of doing them."""
    with running('-p', f'model:={model}', '-p', 'mode:=one_step', *arguments) as node:
        node.start()
        node._worker.stop()
        jobs: list[Any] = []
        monkeypatch.setattr(node._worker, 'do', jobs.append)
        yield node, jobs


def runs(node: TwinNode) -> tuple[str, str]:
    """Let what is loaded take over; say which file runs, and in which mode."""
    node._running.swap_in(node._outlets)
    for outlet in node._outlets:
        outlet.restart()
    (twin,) = {outlet.twin for outlet in node._outlets}
    return str(twin.about['path']), twin.mode


def parameters(node: TwinNode) -> tuple[str, str]:
    return node.get_parameter('model').value, node.get_parameter('mode').value


def copied(model: Path, name: str) -> Path:
    copy = model.parent / f'{name}.yaml'
    copy.write_text(f'{model.read_text("utf-8")}\n# {name}\n', 'utf-8')
    return copy


def damaged(model: Path) -> Path:
    """Write a file that passes the first look, and cannot be loaded."""
    bad = model.parent / 'damaged.yaml'
    bad.write_text(model.read_text('utf-8').replace('sample_time:', 'sample_tame:'), 'utf-8')
    return bad


def test_parameters_that_are_set_one_by_one_are_what_runs_then(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = copied(model, 'other')
    with by_hand(model, monkeypatch) as (node, jobs):
        assert set_(node, 'model', str(other)).successful
        assert set_(node, 'mode', 'free_run').successful
        for job in jobs:
            job()
        assert runs(node) == parameters(node) == (str(other), 'free_run')


def test_without_a_main_model_the_mode_can_be_set_and_is_refused_alone(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running('-p', f'models:=[one={model}]', '-p', 'mode:=one_step') as node:
        node.start()
        node._worker.stop()
        jobs: list[Any] = []
        monkeypatch.setattr(node._worker, 'do', jobs.append)
        assert set_(node, 'mode', 'free_run').successful
        jobs.pop()()
        assert runs(node) == (str(model), 'free_run')
        model.write_text('damaged', 'utf-8')
        assert set_(node, 'mode', 'one_step').successful
        jobs.pop()()
        node._restore()
        assert parameters(node) == ('', 'free_run')


@pytest.mark.parametrize('inactive', [False, True])
@pytest.mark.parametrize('restored', [0, 1, 2])
def test_a_good_model_after_a_refused_one_runs_and_is_what_the_parameter_says(
        model: Path, monkeypatch: pytest.MonkeyPatch, restored: int, inactive: bool) -> None:
    bad, good = damaged(model), copied(model, 'good')
    with by_hand(model, monkeypatch) as (node, jobs):
        if inactive:
            node.trigger_deactivate()
        assert set_(node, 'model', str(bad)).successful
        if restored:            # before the next is asked for; else after it
            jobs.pop()()
        if restored == 2:
            node._restore()
            assert parameters(node) == (str(model), 'one_step')
        assert set_(node, 'model', str(good)).successful
        while jobs:
            jobs.pop(0)()
            node._restore()
        assert runs(node) == parameters(node) == (str(good), 'one_step')


def test_what_was_refused_is_restored_in_every_state_and_forgotten_with_the_models(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = damaged(model)
    with by_hand(model, monkeypatch) as (node, jobs):
        node.trigger_deactivate()
        assert set_(node, 'model', str(bad)).successful
        jobs.pop()()
        node._restore()
        assert parameters(node) == (str(model), 'one_step')
        assert set_(node, 'model', str(bad)).successful
        jobs.pop()()
        node.trigger_cleanup()
        node._restore()
        assert parameters(node)[0] == str(bad)
        assert set_(node, 'model', str(model)).successful
        assert set_(node, 'mode', 'free_run').successful
        node.start()
        assert not set_(node, 'plant', 'cylinder').successful    # which needs a cleanup
        assert runs(node) == parameters(node)


def test_what_is_loaded_while_the_node_is_cleaned_up_does_not_run(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with by_hand(model, monkeypatch) as (node, jobs):
        load = node._running.load

        def slow(*arguments: Any) -> Any:
            twins = load(*arguments)
            node.trigger_deactivate()
            node.trigger_cleanup()
            return twins

        assert set_(node, 'model', str(copied(model, 'other'))).successful
        monkeypatch.setattr(node._running, 'load', slow)
        jobs[0]()
        assert node._running.diagnosis is None
        assert not node._running.waiting
        monkeypatch.setattr(node._running, 'load', load)
        assert set_(node, 'model', str(model)).successful
        node.start()
        jobs[0]()               # as if it had been queued until now
        assert runs(node)[0] == str(model)


def test_diagnostics_go_on_over_a_reload_and_by_the_clock_of_the_bag(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with by_hand(model, monkeypatch, '-p', 'use_sim_time:=true') as (node, jobs):
        diagnosis = node._running.diagnosis
        assert diagnosis is not None
        elapsed: list[float] = []
        monkeypatch.setattr(diagnosis, 'statuses', lambda now, time, publishers:
                            elapsed.append(time) or [])
        clock = node.get_clock()
        assert isinstance(clock, ROSClock)
        for second in (0, 1_700_000_000, 1_700_000_003):
            clock.set_ros_time_override(Time(seconds=second))
            node._diagnose(1.0)
        assert elapsed == [1.0, 1.0, 3.0]
        assert set_(node, 'model', str(copied(model, 'other'))).successful
        jobs.pop()()
        assert node._running.diagnosis is diagnosis
        assert diagnosis.twins[0].about['path'].endswith('other.yaml')


def test_topics_that_are_taken_away_meanwhile_count_nobody(model: Path) -> None:
    with running('-p', f'model:={model}') as node:
        node.start()
        node._worker.stop()
        subscriptions, outputs = dict(node._topics._inputs), list(node._topics._estimates)
        node.trigger_deactivate()
        node.trigger_cleanup()
        node._topics._inputs.update(subscriptions)
        node._topics._estimates.extend(outputs)
        assert set(node._topics.publishers().values()) == {0}
        node._topics.note_subscribers()
        node._topics._inputs.clear()


def test_signals_of_no_plant_say_what_to_set_first() -> None:
    with running() as node:
        refused = set_(node, 'signals.u_m.topic', '/my/command')
        assert not refused.successful
        assert "'model' or 'plant'" in refused.reason
        assert not set_(node, 'plant', 'no_such_plant').successful
        assert set_(node, 'plant', 'load_simulator').successful
        assert set_(node, 'signals.u_m.topic', '/my/command').successful


@pytest.mark.parametrize(('arguments', 'said'), [
    (['signals.u_n.topic:=/x'], "no signal 'u_n'"),
    (['signals.u_m.topik:=/x'], "no 'topik'"),
    (['plant:=valve_servo'], 'a model of load_simulator'),
    (['signals.T_g.field:=effort[0].x'], 'signal T_g: sensor_msgs/msg/JointState has no number'),
    (['signals.T_g.topic:=/a-b'], '/a-b'),
    (['signals.T_g.type:=std_msgs/msg/Float64', 'signals.T_g.field:=data'], 'cannot be'),
    (['qos_overrides./hydro_twin/prediction.publisher.reliability:=sometimes'],
     'topic /hydro_twin/prediction: '),
    (['qos_overrides./load_simulator/command.subscription.history:=some'],
     'topic /load_simulator/command: '),
    (['qos_overrides./load_simulator/command.subscription.depth:=-3'],
     'topic /load_simulator/command: ')])
def test_what_is_wrong_is_a_line_when_the_node_starts(model: Path, arguments: list[str],
                                                      said: str) -> None:
    flags = [word for argument in arguments for word in ('-p', argument)]
    with running('-p', f'model:={model}', *flags) as node:
        with pytest.raises(UserError, match=r'\A.*\Z') as caught:
            node.start()
        assert said in str(caught.value)


def test_inputs_are_named_as_they_are_subscribed_to(model: Path) -> None:
    with running('-p', f'model:={model}', '-r', '__ns:=/rig', '-r',
                 'load_simulator/command:=/elsewhere/command') as node:
        node.start()
        inputs = {'/elsewhere/command', '/rig/load_simulator/joint_states'}
        assert {topic for topic, _ in node.get_subscriber_names_and_types_by_node(
            'hydro_twin', '/rig')} >= inputs
        diagnosis = node._running.diagnosis
        assert diagnosis is not None
        assert {status.part for status in diagnosis.statuses(0, 1.0, {})} >= {
            f'input {topic}' for topic in inputs}


def test_an_inactive_node_says_so_and_alarms_nobody(model: Path,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    with running('-p', f'model:={model}') as node:
        node.start()
        node._worker.stop()   # which diagnoses by itself
        said: list[Any] = []
        monkeypatch.setattr(node._announcer._diagnostics, 'publish', said.append)
        for trigger in (node.trigger_deactivate, node.trigger_activate):
            node._diagnose(1.0)
            trigger()
        node._diagnose(1.0)
        active, inactive, again = ([(s.name, ord(s.level), s.message) for s in message.status]
                                   for message in said)
        assert {name for name, _, _ in active} == {f'hydro_twin: {part}' for part in (
            'input /load_simulator/command', 'input /load_simulator/joint_states',
            'input /load_simulator/pressure', 'input /load_simulator/spool',
            'input /load_simulator/motor', 'time', 'model main')}
        assert any(level > 0 for _, level, _ in active)   # no message yet
        assert inactive == [(name, 0, 'inactive') for name, _, _ in active]
        assert [name for name, _, _ in again] == [name for name, _, _ in active]
        assert {s.hardware_id for message in said for s in message.status} == {'load_simulator'}


def test_setting_all_parameters_to_what_they_are_does_nothing(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running('-p', f'model:={model}', '-p', 'wait:=1') as node:
        node.start()
        jobs: list[object] = []
        monkeypatch.setattr(node._worker, 'do', jobs.append)
        names = node.list_parameters([], 0).names
        assert {'autostart', 'models', 'signals.u_m.topic', 'use_sim_time'} <= set(names)
        assert any(name.startswith('qos_overrides.') for name in names)
        for parameter in node.get_parameters(names):
            assert node.set_parameters_atomically([parameter]).successful, parameter.name
        assert not jobs
        model.write_text(model.read_text('utf-8') + '\n', 'utf-8')   # the file is another one
        assert set_(node, 'model', str(model)).successful
        assert len(jobs) == 1


def test_a_wait_may_be_whole_and_autostart_is_read_once() -> None:
    with running('-p', 'wait:=1') as node:
        assert set_(node, 'wait', 2).successful
        assert not set_(node, 'wait', 11).successful
        refused = set_(node, 'autostart', False)
        assert not refused.successful
        assert 'read-only' in refused.reason
