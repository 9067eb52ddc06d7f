"""What the tests of live operation share: a node that listens and asks, and real processes."""
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState

INPUTS = ('/load_simulator/command', '/load_simulator/joint_states')
OUTPUTS = ('/hydro_twin/prediction', '/hydro_twin/residual')
DIAGNOSTICS = '/diagnostics'
DEPTH = 5000      # messages: more than a test sends
PATIENCE = 120.0   # s; nothing here is timed, this only ends a test that hangs
GUARD = 7200      # UDP ports from here on, below those of DDS, say which domains are taken


@contextlib.contextmanager
def own_domain() -> Iterator[None]:
    """Take a ROS domain that no other test has, in this run or in another on this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as guard, \
            pytest.MonkeyPatch.context() as patch:
        for domain in range(1, 101):
            with contextlib.suppress(OSError):
                guard.bind(('127.0.0.1', GUARD + domain))
                break
        else:
            pytest.fail('all ROS domains are taken')
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        patch.setenv('ROS_DOMAIN_ID', str(domain))
        yield


def lossless(inputs: Sequence[str] = INPUTS, outputs: Sequence[str] = OUTPUTS,
             ) -> dict[str, object]:
    """Make parameters with which the node loses nothing and makes nothing up, however late."""
    settings = [*((topic, 'subscription') for topic in inputs),
                *((topic, 'publisher') for topic in outputs)]
    return {f'qos_overrides.{topic}.{entity}.{policy}': value for topic, entity in settings
            for policy, value in (('reliability', 'reliable'), ('depth', DEPTH))} | {'wait': 10.0}


@contextlib.contextmanager
def running_node[N: Node](kind: Callable[[], N], *arguments: str) -> Iterator[N]:
    """Make a node that does not spin, with these ROS arguments, on a domain of its own."""
    with own_domain():
        rclpy.init(args=['test', '--ros-args', '--log-level', 'fatal', *arguments])
        try:
            node = kind()
            try:
                yield node
            finally:
                node.destroy_node()
        finally:
            rclpy.try_shutdown()


@contextlib.contextmanager
def running_rig() -> Iterator[Rig]:
    """Make a rig, on a domain of its own."""
    with own_domain():
        rclpy.init(args=[])
        made = Rig()
        try:
            yield made
        finally:
            made.node.destroy_node()
            rclpy.try_shutdown()


class Rig:
    """The test's own node, which listens, asks and drives."""

    def __init__(self) -> None:
        self.node = rclpy.create_node('rig')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.heard: dict[str, list[Any]] = {DIAGNOSTICS: []}
        self._diagnostics: Any = None

    def listen(self, topic: str, kind: Any, latched: bool = False) -> list[Any]:
        heard = self.heard.setdefault(topic, [])
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        self.node.create_subscription(kind, topic, heard.append,
                                      QoSProfile(depth=DEPTH, durability=durability))
        return heard

    def until(self, condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
        end = time.monotonic() + patience
        while time.monotonic() < end:
            if found := condition():
                return found
            self.executor.spin_once(timeout_sec=0.02)
        counts = {topic: len(heard) for topic, heard in self.heard.items()}
        said = list(dict.fromkeys(f'{status.name}: {status.message}'
                                  for message in self.heard[DIAGNOSTICS]
                                  for status in message.status))
        return pytest.fail('\n'.join([f'waited in vain until {what}', f'heard: {counts}',
                                      'diagnostics:', *said]))

    def service(self, name: str) -> Any:
        """Call a service that takes nothing."""
        from std_srvs.srv import Trigger

        return self.call(Trigger, name, Trigger.Request())

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f'{name} is there')
        future = client.call_async(request)
        self.until(future.done, f'{name} answers')
        self.node.destroy_client(client)
        return future.result()

    def status(self, part: str, text: str) -> Any:
        """Wait until the node says something of one of its parts."""
        return self.until(lambda: next(
            (s for m in self.heard[DIAGNOSTICS] for s in m.status
             if s.name.endswith(part) and text in s.message), None), f'{part} says {text!r}')

    def ready(self, inputs: Sequence[str] = INPUTS) -> None:
        """Wait until the node listens to the inputs, and all who shall hear it have found it."""
        for topic in inputs:
            self.until(lambda t=topic: self.node.count_subscribers(t), f'{topic} has a listener')
        for topic in self.heard:
            self.until(lambda t=topic: self.node.count_publishers(t), f'{topic} has a publisher')
        # Announced after the others: when the node has found this one, it has found them all.
        if self._diagnostics is not None:
            self.node.destroy_subscription(self._diagnostics)
        said = self.heard[DIAGNOSTICS]
        said.clear()
        self._diagnostics = self.node.create_subscription(
            DiagnosticArray, DIAGNOSTICS, said.append, QoSProfile(depth=DEPTH))
        self.until(lambda: said, 'the node says how it is')


@contextlib.contextmanager
def ended(running: subprocess.Popen[Any]) -> Iterator[None]:
    """End a process as its user does, or else by force."""
    try:
        yield
    finally:
        running.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            running.wait(PATIENCE)
        running.kill()


@contextlib.contextmanager
def process(*arguments: str) -> Iterator[None]:
    """Run a module, which ends well when it is interrupted."""
    with subprocess.Popen([sys.executable, '-m', *arguments]) as running, ended(running):
        yield
    assert running.returncode == 0


@contextlib.contextmanager
def twin(**parameters: object) -> Iterator[None]:
    """Run the node."""
    flags = [word for name, value in parameters.items()
             for word in ('-p', f'{name}:={value}')]
    with process('hydro_twin.ros.spin', '--ros-args', *flags):
        yield


def play(bag: Path, *flags: str) -> None:
    """Play a bag to its end."""
    subprocess.run([sys.executable, '-m', 'hydro_twin.commands.main', 'replay', str(bag),
                    '--publish', *flags], check=True, timeout=PATIENCE)


def stamp_of(message: JointState) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
