"""What the node says of itself on its topics: models, events, diagnostics."""
from __future__ import annotations

from collections.abc import Sequence
import json
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from std_msgs.msg import String

from hydro_twin.live.diagnostics import Status
from hydro_twin.live.monitor import Rise
from hydro_twin.live.twin import Twin
from hydro_twin.ros.topics import errors_name_topic, OVERRIDES


class Announcer:
    """The topics that are not predictions; for any thread."""

    def __init__(self, node: Node) -> None:
        """Publish in the name of a node."""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._name = node.get_fully_qualified_name().strip('/')
        with errors_name_topic('~/model_info'):
            self._info = node.create_publisher(String, '~/model_info', latched,
                                               qos_overriding_options=OVERRIDES)
        self._event = node.create_publisher(String, '~/model_event', 10)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def info(self, twins: Sequence[Twin]) -> None:
        """Say what is run, for those who come later too."""
        self._info.publish(String(data=json.dumps([twin.about for twin in twins])))

    def event(self, event: str, **about: Any) -> None:
        """Say that something happened to a model."""
        self._event.publish(String(data=json.dumps({'event': event, **about})))

    def refit(self, twin: Twin, rise: Rise, topics: Sequence[str]) -> None:
        """Say that a model no longer holds, and where the fault enters."""
        location = rise.location and {
            'ports': rise.location.ports, 'says': str(rise.location),
            'gain': rise.location.gain, 'others': dict(rise.location.others)}
        self.event('refit', model=twin.name, topics=topics, begin=rise.begin, settled=rise.settled,
                   end=rise.end, rms=rise.rms, reference_rms=rise.reference_rms, sign=rise.sign,
                   location=location)

    def diagnostics(self, now: Time, plant: str, statuses: Sequence[Status]) -> None:
        """Say how things stand; the hardware is the plant."""
        self._diagnostics.publish(diagnostic_array(self._name, now, plant, statuses))


def diagnostic_array(name: str, now: Time, plant: str, statuses: Sequence[Status],
                     ) -> DiagnosticArray:
    """Write statuses as the node of that name publishes them."""
    message = DiagnosticArray(status=[
        DiagnosticStatus(name=f'{name}: {status.part}', level=bytes([status.level]),
                         message=status.message, hardware_id=plant,
                         values=[KeyValue(key=k, value=v) for k, v in status.values.items()])
        for status in statuses])
    message.header.stamp = now.to_msg()
    return message
