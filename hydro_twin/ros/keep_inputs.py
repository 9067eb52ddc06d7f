"""What `keep` listens to: the inputs of the twin, and what else is captured."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
import time

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_topic_name import validate_topic_name

from hydro_twin.errors import ModelError, UserError
from hydro_twin.keep.keeper import Keeper
from hydro_twin.live.inputs import Feed, TwinInputs
from hydro_twin.live.messages import learn, message_class
from hydro_twin.model import read_model
from hydro_twin.plants import plant_named
from hydro_twin.ros.parameters import SignalParameters
from hydro_twin.ros.topics import errors_name_topic, Topics

DEPTH = 5000     # messages that may wait: a thread that loads a model takes its time
WAIT = 0.1       # for late inputs, as the twin does by default [s]


class Inputs:
    """Subscriptions of a node that feed a keeper.

    Attributes:
        twin_inputs: the samples of the inputs, once a model says of which plant.
        plant: its name, or ''.
    """

    def __init__(self, node: Node, keeper: Keeper, guarded: Callable[..., None],
                 overrides: Mapping[str, Parameter], wanted: Sequence[str]) -> None:
        """Listen to nothing yet.

        Args:
            node: that subscribes.
            keeper: that is fed.
            guarded: calls a function with its arguments, and raises nothing.
            overrides: parameters that the node was started with.
            wanted: more topics to capture, once somebody publishes them.

        Raises:
            UserError: one of these is no name of a topic.
        """
        self._node, self._keeper, self._guarded = node, keeper, guarded
        self._topics = Topics(node, DEPTH)
        self._signals = SignalParameters(node, overrides)
        self._wanted = [self._resolved(name) for name in wanted]
        self._jumps = 0
        self.twin_inputs: TwinInputs | None = None
        self.plant = ''

    def listen(self, model: Path, plant: str) -> None:
        """Subscribe to the inputs of the plant of a model.

        Args:
            model: its file.
            plant: that it must be of, or ''.

        Raises:
            UserError: the model or the signal parameters are wrong.
        """
        about = read_model(model)
        name = about.plant.name
        if plant not in ('', name):
            raise ModelError(f"{model}: a model of {name}, but the parameter 'plant' is {plant}")
        known = plant_named(name)
        signals = self._topics.resolved(self._signals.read(known))
        inputs = TwinInputs(known, signals, about.sample_time, WAIT)
        try:
            for feed in inputs.feeds:
                learn(feed.type)
                self._topics.listen(feed, partial(self._guarded, self._take, inputs, feed))
        except UserError:
            self._topics.stop_listening()      # the next try begins anew
            raise
        self._keeper.signals = signals
        self._keeper.topics |= {feed.topic: (feed.type, False) for feed in inputs.feeds}
        self.twin_inputs, self.plant = inputs, name

    def _take(self, inputs: TwinInputs, feed: Feed, payload: bytes) -> None:
        """Take in a message: into the ring, and to the models that are judged."""
        received = self._now()
        aligner, keeper = inputs.aligner, self._keeper
        if not inputs.begun:
            inputs.begin(self._topics.publishers())
        inputs.take(feed, payload, lambda: received)
        if aligner.jumps != self._jumps:
            self._jumps = aligner.jumps
            keeper.ring.clear()
            keeper.times.clear()
        keeper.ring.add(feed.topic, time.monotonic_ns(), received, bytes(payload))
        while aligner.advance():
            if (duel := keeper.judge.duel) is not None:
                if aligner.first:
                    duel.restart()
                duel.step(aligner.stamp, aligner.inputs, aligner.measured, aligner.sensors)

    def subscribe_to_published(self) -> None:
        """Subscribe to what else is captured, once it is published; find what is latched.

        What cannot be subscribed to is in `Keeper.uncaptured`, and tried again the next time.
        """
        known = dict(self._node.get_topic_names_and_types())
        feeds = self.twin_inputs.feeds if self.twin_inputs is not None else ()
        inputs = {feed.topic for feed in feeds}
        # Inputs age however they are published: of a stretch only that stretch is wanted.
        for topic in self._keeper.topics.keys() - inputs:
            if self._is_latched(topic):
                self._keeper.ring.latch(topic)
        for topic in list(self._wanted):
            # One that is only listened to says nothing of how it will be published.
            if (topic in self._keeper.topics or topic not in known
                    or not self._node.get_publishers_info_by_topic(topic)):
                continue
            try:
                self._subscribe(topic, known[topic][0])
            except Exception as error:      # of a type, whose code may raise anything
                self._keeper.uncaptured[topic] = ' '.join(str(error).split())
            else:
                self._keeper.uncaptured.pop(topic, None)
                self._wanted.remove(topic)

    def _subscribe(self, topic: str, kind: str) -> None:
        """Subscribe to a topic that is captured only.

        Raises:
            UserError: its type is not installed.
        """
        latched = self._is_latched(topic)
        learn(kind)
        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE if latched
                         else ReliabilityPolicy.BEST_EFFORT,
                         durability=DurabilityPolicy.TRANSIENT_LOCAL if latched
                         else DurabilityPolicy.VOLATILE)
        self._node.create_subscription(message_class(kind), topic, partial(
            self._guarded, self._keep, topic), qos, raw=True)
        self._keeper.topics[topic] = (kind, latched)
        if latched:
            self._keeper.ring.latch(topic)

    def _resolved(self, name: str) -> str:
        """Name a wanted topic as it is subscribed to.

        Raises:
            UserError: it is no name of a topic.
        """
        with errors_name_topic(name):
            validate_topic_name(name)
            return str(self._node.resolve_topic_name(name))

    def _is_latched(self, topic: str) -> bool:
        return any(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                   for info in self._node.get_publishers_info_by_topic(topic))

    def _keep(self, topic: str, payload: bytes) -> None:
        """Take in a message of a topic that is captured only."""
        self._keeper.ring.add(topic, time.monotonic_ns(), self._now(), bytes(payload))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
