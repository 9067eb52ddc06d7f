"""Predictions as serialised sensor_msgs/msg/JointState, without an object a message."""
from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np
from rosbags.typesys import get_typestore, Stores

from hydro_twin.recording.cdr import lay_out

TYPE = 'sensor_msgs/msg/JointState'
FIELDS = {'N': 'effort', 'N m': 'effort', 'm/s': 'velocity', 'rad/s': 'velocity'}


class Writer:
    """Writes values of the same joints again and again."""

    def __init__(self, joints: Sequence[str], unit: str) -> None:
        """Write torque and force as effort, speed as velocity, all else as position."""
        store = get_typestore(Stores.ROS2_JAZZY)
        types = store.types
        field = FIELDS.get(unit, 'position')
        stamp = types['builtin_interfaces/msg/Time'](sec=0, nanosec=0)
        message = types[TYPE](
            header=types['std_msgs/msg/Header'](stamp=stamp, frame_id=''), name=list(joints),
            **{name: np.zeros(len(joints) * (name == field))
               for name in ('position', 'velocity', 'effort')})
        self._payload = bytearray(store.serialize_cdr(message, TYPE))
        layout = lay_out(bytes(self._payload), TYPE, store)
        self._stamp = layout.leaves['header.stamp.sec'].offset
        self._value = layout.leaves[field].offset
        self._values = struct.Struct(f'<{len(joints)}d')

    def write(self, stamp: int, *values: float) -> bytes:
        """Write a value for each joint with their stamp [ns]."""
        struct.pack_into('<iI', self._payload, self._stamp, *divmod(stamp, 1_000_000_000))
        self._values.pack_into(self._payload, self._value, *values)
        return bytes(self._payload)
