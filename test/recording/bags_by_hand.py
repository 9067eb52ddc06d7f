"""Bags made message by message with rosbags, independently of what writes bags in the package."""
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = 'sensor_msgs/msg/JointState'
FLOAT64 = 'std_msgs/msg/Float64'
Message = tuple[str, int, Any]   # topic, receive time [ns], message


def stamp(time: int) -> Any:
    return STORE.types['builtin_interfaces/msg/Time'](time // 10**9, time % 10**9)


def header(time: int, frame: str = '') -> Any:
    return STORE.types['std_msgs/msg/Header'](stamp(time), frame)


def joint_state(time: int, names: Iterable[str] = ('shaft',), position: Any = (),
                effort: Any = (), frame: str = '') -> Any:
    return STORE.types[JOINT_STATE](
        header(time, frame), list(names), np.array(position, float), np.zeros(0),
        np.array(effort, float))


def float64(value: float) -> Any:
    return STORE.types[FLOAT64](value)


def write_bag(path: Path, messages: Iterable[Message], storage: str = 'mcap',
              compression: str = 'NONE', types: dict[str, str] | None = None) -> Path:
    """Write messages; `types` adds topics that carry none."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, msgtype, typestore=STORE)
                       for topic, msgtype in (types or {}).items()}
        for topic, received, message in messages:
            msgtype = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE)
            writer.write(connections[topic], received, STORE.serialize_cdr(message, msgtype))
    return path


def rig(count: int = 50, start: int = 10**18, step: int = 2_000_000,
        seed: int = 0) -> list[Message]:
    """Make the messages of a rig: command and state, both stamped, received a little later."""
    rng = np.random.default_rng(seed)
    messages: list[Message] = []
    for k in range(count):
        time = start + k * step
        u, x, T = rng.standard_normal(3)
        messages.append(('/command', time + 100_000, joint_state(time, ['valve'], [u])))
        messages.append(('/states', time + 200_000,
                         joint_state(time, ['shaft', 'rudder'], [0.0, x], [T, 0.0])))
    return messages
