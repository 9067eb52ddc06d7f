"""Plays a bag's topics into ROS with their recorded pacing, for machines without `ros2 bag`."""
from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from pathlib import Path
import signal
import sys
import time
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from hydro_twin.errors import UserError
from hydro_twin.live.messages import message_class
from hydro_twin.recording.bag import opened

TICK = 0.025       # between two messages on /clock [s], as `ros2 bag play` has it
FIRST = 10.0       # how long anyone to listen is waited for [s]
MORE = 3.0         # and after the first, for those of the other topics [s]
SETTLE = 0.5       # until listeners have found us as we have found them [s]
ACKNOWLEDGED = 2.0   # how long the last messages may take to arrive [s]
DEPTH = 5000       # messages kept for a listener that is slow, 10 s of them at 500 Hz


def play(bag: Path, rate: float = 1.0, loop: bool = False, clock: bool = False,
         ros_arguments: Sequence[str] = ()) -> dict[str, int]:
    """Play a bag until its end, or until interrupted.

    Args:
        bag: a folder, or a single .mcap or .db3 file.
        rate: times as fast as recorded.
        loop: begin again at the end.
        clock: publish the bag's time on /clock, for nodes with use_sim_time.
        ros_arguments: what would follow `--ros-args`: remappings, a name, a namespace.

    Returns:
        Topic, as it was published -> messages until then.

    Raises:
        BagError: the bag cannot be read.
        UserError: the rate is not above 0, a bag without messages is to be played in a loop, a
            message type of the bag is not installed, or a ROS argument is wrong.
    """
    if not rate > 0.0:
        raise UserError(f'rate {rate:g}: must be above 0')
    # With rclpy's own handler an interrupt would end the context in the midst of a message.
    try:
        rclpy.init(args=[sys.argv[0], '--ros-args', *ros_arguments],
                   signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:   # of rcl
        raise UserError(str(error)) from error
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    # It does not spin, so it must not offer services: whoever called one would wait for ever.
    node = Node('hydro_twin_player', start_parameter_services=False, parameter_overrides=[
        Parameter('start_type_description_service', value=False)])
    try:
        with opened(bag) as reader:
            if loop and not reader.message_count:
                raise UserError(f'{bag}: has no messages, so there is nothing to play in a loop')
            player = _Player(node, reader, rate, clock)
            with contextlib.suppress(KeyboardInterrupt):
                player.run(loop)
        return player.count
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


class _Player:
    """One bag on its way into ROS."""

    def __init__(self, node: Node, reader: Any, rate: float, clock: bool) -> None:
        self._node = node
        self._reader = reader
        self._rate = rate
        self._publishers = {
            connection.id: node.create_publisher(
                message_class(connection.msgtype), connection.topic, _qos(connection))
            for connection in reader.connections}
        self._clock = node.create_publisher(Clock, '/clock', 10) if clock else None
        self.count = {publisher.topic_name: 0 for publisher in self._publishers.values()}

    def run(self, loop: bool) -> None:
        """Play once, or until stopped."""
        publishers = list(self._publishers.values())
        if not _await_listeners(publishers):
            self._node.get_logger().warning('nobody listens to the topics of this bag')
        while True:
            for connection, payload in self._paced():
                publisher = self._publishers[connection.id]
                publisher.publish(payload)
                self.count[publisher.topic_name] += 1
            if not loop:
                break
        for publisher in publishers:
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))

    def _paced(self) -> Iterator[tuple[Any, bytes]]:
        """Yield the messages when they are due."""
        begin = self._reader.start_time
        started = ticked = time.monotonic()
        for connection, stamp, payload in self._reader.messages():
            due = started + (stamp - begin) * 1e-9 / self._rate
            while (now := time.monotonic()) < due or (self._clock and now >= ticked):
                if self._clock and now >= ticked:
                    passed = round((now - started) * self._rate * 1e9)
                    self._clock.publish(Clock(clock=Time(nanoseconds=begin + passed).to_msg()))
                    ticked += TICK
                else:
                    time.sleep(min(due, ticked if self._clock else due) - now)
            yield connection, bytes(payload)


def _qos(connection: Any) -> QoSProfile:
    """Return a reliable QoS, transient local if the topic was recorded so."""
    latched = any(profile.durability.name == 'TRANSIENT_LOCAL'
                  for profile in connection.ext.offered_qos_profiles)
    return QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL if latched
                      else DurabilityPolicy.VOLATILE)


def _await_listeners(publishers: Sequence[Publisher]) -> int:
    """Wait until someone listens to each topic, so that the first messages arrive.

    A machine under load takes seconds to find another process. Who has found it knows at once
    most of what it listens to, so a topic of which nobody wants to hear does not delay for long.

    Returns:
        The topics that someone listens to.
    """
    found, until = 0, time.monotonic() + FIRST
    while found < len(publishers) and time.monotonic() < until:
        count = sum(publisher.get_subscription_count() > 0 for publisher in publishers)
        if count > found:
            found, until = count, time.monotonic() + MORE
        time.sleep(TICK)
    time.sleep(SETTLE)
    return found
