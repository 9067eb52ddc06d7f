"""The node of `keep` in this process, without a twin: what it listens to, and what may fail."""
from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402,I100
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from ros_rig import running_node  # noqa: E402
from store_models import write  # noqa: E402

from hydro_twin.errors import UserError  # noqa: E402
from hydro_twin.keep.ring import SECOND  # noqa: E402
from hydro_twin.recording.digest import source_of  # noqa: E402
from hydro_twin.ros import keep_inputs  # noqa: E402
from hydro_twin.ros.keep import KeepNode  # noqa: E402
from hydro_twin.store.store import Store  # noqa: E402

# What rclpy imports imports what is out of date.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_")

COMMAND = '/load_simulator/command'


def running(folder: Path, *arguments: str) -> contextlib.AbstractContextManager[KeepNode]:
    """Make a node that does not spin, with its store in a folder."""
    flags = [word for argument in (f'store:={folder / "store"}', *arguments)
             for word in ('-p', argument)]
    return running_node(KeepNode, *flags)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Make a store with a champion."""
    made = Store(tmp_path / 'store')
    made.promote(made.enter(write(tmp_path / 'first.yaml'), 'me').name, 'me')
    return made


def ticks(node: KeepNode, count: int, monkeypatch: pytest.MonkeyPatch) -> list[DiagnosticArray]:
    """Let the timer fire so many times; returns what was published."""
    said: list[DiagnosticArray] = []
    monkeypatch.setattr(node._diagnostics, 'publish', said.append)
    for _ in range(count):
        node._on_tick()
    return said


def publishing(node: KeepNode, monkeypatch: pytest.MonkeyPatch, **topics: tuple[str, bool]
               ) -> None:
    """Make the node see topics as published by others: name -> type, and whether it is latched."""
    known = {f'/{name}': about for name, about in topics.items()}
    latched = {True: DurabilityPolicy.TRANSIENT_LOCAL, False: DurabilityPolicy.VOLATILE}
    monkeypatch.setattr(node, 'get_topic_names_and_types', lambda: [
        (topic, [kind]) for topic, (kind, _) in known.items()])
    monkeypatch.setattr(node, 'get_publishers_info_by_topic', lambda topic: [
        SimpleNamespace(qos_profile=QoSProfile(depth=1, durability=latched[known[topic][1]]))
    ] if topic in known else [])


@pytest.mark.parametrize('argument', ['plant:=cylinder', 'signals.T_g.type:=no_such/msg/Type'])
def test_inputs_that_cannot_be_listened_to_stop_neither_loop_nor_diagnostics(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, argument: str) -> None:
    """The store is empty, so which plant it is shows when the twin says what it runs."""
    first = write(tmp_path / 'first.yaml')
    with running(tmp_path, argument) as node:
        node.keeper.informed([{'name': '', 'path': str(first), 'mode': 'one_step',
                               'sha256': source_of(first).sha256}])
        done: list[int] = []
        tick = node.keeper.tick
        monkeypatch.setattr(node.keeper, 'tick', lambda now: (tick(now), done.append(now)))
        said = ticks(node, 3, monkeypatch)
        assert len(done) == len(said) == 3
        assert argument.rpartition('=')[2] in said[-1].status[0].message
        assert node._inputs.twin_inputs is None
        assert not node.keeper.signals
        assert not node._inputs._topics.publishers()


def test_inputs_are_not_subscribed_to_twice_where_one_of_them_fails(
        store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(tmp_path) as node:
        inputs = node._inputs
        inputs._topics.stop_listening()
        inputs.twin_inputs, heard = None, list(node.subscriptions)
        learnt: list[str] = []

        def fails(kind: str) -> None:
            if learnt:
                raise UserError('a type is not installed')
            learnt.append(kind)

        with monkeypatch.context() as patch:
            patch.setattr(keep_inputs, 'learn', fails)
            with pytest.raises(UserError, match='not installed'):
                node._listen(store.champion)
        assert list(node.subscriptions) == heard
        node._listen(store.champion)
        assert inputs.plant == 'load_simulator'


def test_a_topic_of_a_type_that_is_not_installed_costs_no_other_topic(
        store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(tmp_path, 'topics:=[/strange, /known]') as node:
        publishing(node, monkeypatch, strange=('no_such/msg/Type', False),
                   known=('std_msgs/msg/String', True))
        (*_, said) = ticks(node, 2, monkeypatch)
        assert node.keeper.topics['/known'] == ('std_msgs/msg/String', True)
        assert '/strange' not in node.keeper.topics
        assert '/strange is not captured: message type no_such/msg/Type' in said.status[0].message
        publishing(node, monkeypatch, strange=('std_msgs/msg/String', False))
        (said,) = ticks(node, 1, monkeypatch)
        assert node.keeper.topics['/strange'] == ('std_msgs/msg/String', False)
        assert 'not captured' not in said.status[0].message


def test_inputs_that_are_published_latched_age_all_the_same(
        store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(tmp_path, 'topics:=[/map]', 'before:=10.0') as node:
        ring = node.keeper.ring
        publishing(node, monkeypatch, map=('std_msgs/msg/String', True),
                   **{COMMAND.strip('/'): ('sensor_msgs/msg/JointState', True)})
        ticks(node, 2, monkeypatch)
        assert ring.latched() == {'/map'}
        for k in range(100):
            for topic in ('/map', COMMAND):
                ring.add(topic, k * SECOND, k, b'')
        kept = [topic for _, topic, _ in ring.stretch(95 * SECOND)]
        assert (kept.count('/map'), kept.count(COMMAND)) == (100, 5)


@pytest.mark.parametrize(('arguments', 'says'), [
    (['topics:=[/a-b]'], 'topic /a-b: '), (['plant:=none'], "no plant 'none'"),
    (['plant:=load_simulator', 'limits:=["B_mm=1..2"]'], 'no parameter B_mm')])
def test_what_cannot_be_is_a_line_at_the_start(tmp_path: Path, arguments: list[str], says: str,
                                               ) -> None:
    with pytest.raises(UserError, match=r'\A.*\Z') as raised, running(tmp_path, *arguments):
        pass
    assert says in str(raised.value)


def test_limits_are_those_of_the_plant_as_soon_as_it_is_known(store: Store, tmp_path: Path,
                                                              ) -> None:
    def set_(node: Node, limit: str) -> Any:
        return node.set_parameters_atomically([Parameter('limits', value=[limit])])

    with running(tmp_path) as node:
        assert set_(node, 'B_m=1..2').successful
        assert set_(node, 'friction@motor:coulomb=0..20').successful
        refused = set_(node, 'B_mm=1..2')
        assert not refused.successful
        assert 'no parameter B_mm; load_simulator has V_m, J' in refused.reason
    with pytest.raises(UserError, match='no parameter B_mm'), running(
            tmp_path, 'limits:=["B_mm=1..2"]'):
        pass
