"""The topics of the node: its inputs while it is active, its outputs while it is configured."""
from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from rclpy.exceptions import InvalidHandle, NameValidationException, ParameterException
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.validate_topic_name import validate_topic_name
from sensor_msgs.msg import JointState

from hydro_twin.errors import UserError
from hydro_twin.live.inputs import Feed
from hydro_twin.live.messages import check_field, message_class
from hydro_twin.live.outlet import Outlet
from hydro_twin.live.twin import Twin
from hydro_twin.recording.signals import SignalMap

DEPTH = 200      # messages: a hiccup of 400 ms at 500 Hz
OVERRIDES = QoSOverridingOptions.with_default_policies()


@contextmanager
def errors_name_topic(topic: str) -> Iterator[None]:
    """Turn what rclpy raises for a name or a QoS override of the user's into a line.

    Raises:
        UserError: instead of that.
    """
    try:
        yield
    except (RuntimeError, TypeError, ValueError, ParameterException,
            NameValidationException) as error:
        raise UserError(f'topic {topic}: {" ".join(str(error).split())}') from error


def _count(count: Callable[[], int]) -> int:
    """Ask one end of a topic for the others; 0 where another thread has just taken it away."""
    try:
        return count()
    except InvalidHandle:
        return 0


class Topics:
    """Makes subscriptions and publishers, and takes them away."""

    def __init__(self, node: LifecycleNode | Node, depth: int = DEPTH) -> None:
        """Make nothing yet; `depth` is how many messages of an input may wait."""
        self._node: Any = node     # one with a lifecycle, where it has outputs
        self._depth = depth
        self._given: dict[str, str] = {}   # resolved name -> as it was given
        self._inputs: dict[str, Subscription] = {}
        self._outputs: list[LifecyclePublisher] = []
        self._estimates: list[tuple[Outlet, dict[str, LifecyclePublisher]]] = []

    def resolved(self, signals: Mapping[str, SignalMap]) -> dict[str, SignalMap]:
        """Check where signals are to be found, and name their topics as they are subscribed to.

        Raises:
            UserError: a message type is not installed or lacks the field, or a name is no topic.
        """
        found: dict[str, SignalMap] = {}
        types: dict[str, str] = {}
        for name, where in signals.items():
            with errors_name_topic(where.topic):
                validate_topic_name(where.topic)
                topic = self._node.resolve_topic_name(where.topic)
            try:
                check_field(where)
            except UserError as error:
                raise UserError(f'signal {name}: {error}') from None
            if types.setdefault(topic, where.type) != where.type:
                raise UserError(f'topic {topic} cannot be {types[topic]} and {where.type}')
            self._given[topic] = where.topic
            found[name] = replace(where, topic=topic)
        return found

    def listen(self, feed: Feed, callback: Callable[[bytes], None]) -> None:
        """Subscribe to a topic that `resolved` has named.

        Raises:
            UserError: a QoS override is wrong.
        """
        with errors_name_topic(feed.topic):
            self._inputs[feed.topic] = self._node.create_subscription(
                message_class(feed.type), self._given[feed.topic], callback,
                QoSProfile(depth=self._depth, reliability=ReliabilityPolicy.BEST_EFFORT), raw=True,
                qos_overriding_options=OVERRIDES)

    def outlet(self, twin: Twin, horizon: int) -> Outlet:
        """Create the topics of a twin, one of which is so many samples ahead.

        Raises:
            UserError: a QoS override is wrong.
        """
        prefix = f'~/{twin.name}/' if twin.name else '~/'
        outputs = {topic: self._output(f'{prefix}{topic}') for topic in (
            'prediction', 'residual', 'states', 'ahead', 'parameters')}
        outlet = Outlet(twin, horizon, *(output.publish for output in outputs.values()))
        self._estimates.append((outlet, outputs))
        return outlet

    def note_subscribers(self) -> None:
        """See for which twins somebody listens to what costs work."""
        for outlet, outputs in list(self._estimates):
            outlet.states_wanted, outlet.ahead_wanted, outlet.parameters_wanted = (
                _count(outputs[topic].get_subscription_count) > 0
                for topic in ('states', 'ahead', 'parameters'))

    def _output(self, topic: str) -> Any:
        with errors_name_topic(self._node.resolve_topic_name(topic)):
            self._outputs.append(self._node.create_lifecycle_publisher(
                JointState, topic, QoSProfile(depth=DEPTH), qos_overriding_options=OVERRIDES))
        return self._outputs[-1]

    def publishers(self) -> dict[str, int]:
        """Count who publishes on each topic that is listened to."""
        return {topic: _count(subscription.get_publisher_count)
                for topic, subscription in list(self._inputs.items())}

    def stop_listening(self) -> None:
        """Unsubscribe."""
        while self._inputs:
            self._node.destroy_subscription(self._inputs.popitem()[1])

    def close(self) -> None:
        """Unsubscribe, and publish no more."""
        self.stop_listening()
        self._estimates.clear()
        while self._outputs:
            self._node.destroy_lifecycle_publisher(self._outputs.pop())
        self._given.clear()
