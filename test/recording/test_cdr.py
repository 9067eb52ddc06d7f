"""Columns against rosbags' own deserialiser, over types of every shape."""
from bags_by_hand import header, STORE
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from hydro_twin.recording.cdr import Batch, CdrError, Extractor, lay_out
from hydro_twin.recording.signals import SignalMap

ODD = 'test_msgs/msg/Odd'
INNER = 'test_msgs/msg/Inner'
TYPES = get_typestore(Stores.ROS2_JAZZY)
TYPES.register({
    **get_types_from_msg('uint8 a\nfloat64 b\nstring c', INNER),
    **get_types_from_msg(
        'std_msgs/Header header\nbool flag\nstring[] joint_names\nint8[] bytes\n'
        'float32[] values\nuint16 number\ntest_msgs/Inner[] inner\nfloat64[3] three\n'
        'string[2] pair\ntest_msgs/Inner[2] twins\nint64 last', ODD)})
PATHS = ['flag', 'number', 'three[1]', 'twins[1].b', 'last', 'header.stamp.nanosec']
text = st.text(max_size=5)
inner = st.builds(TYPES.types[INNER], st.integers(0, 255), st.floats(allow_nan=False), text)


@st.composite
def odd(draw):
    names = draw(st.lists(st.sampled_from(['a', 'bb', 'rudder']), unique=True, max_size=3))
    return TYPES.types[ODD](
        header(draw(st.integers(0, 10**18)), draw(text)), draw(st.booleans()), names,
        np.array(draw(st.lists(st.integers(-128, 127), max_size=5)), np.int8),
        np.arange(len(names), dtype=np.float32) + draw(st.integers(0, 99)),
        draw(st.integers(0, 65535)), draw(st.lists(inner, max_size=3)),
        np.array(draw(st.lists(st.floats(allow_nan=False), min_size=3, max_size=3))),
        [draw(text), draw(text)], [draw(inner), draw(inner)],
        draw(st.integers(-2**53, 2**53)))


def batch(payloads):
    length = np.array([len(payload) for payload in payloads])
    return Batch(np.arange(len(payloads)), np.frombuffer(b''.join(payloads), np.uint8),
                 np.cumsum(length) - length, length)


@pytest.mark.slow
@given(messages=st.lists(odd(), min_size=1, max_size=6), little=st.booleans())
def test_columns_equal_the_deserialised_fields(messages, little):
    payloads = [bytes(TYPES.serialize_cdr(m, ODD, little_endian=little)) for m in messages]
    paths = [*PATHS, 'values[rudder]']
    columns = Extractor(ODD, TYPES, paths).take(batch(payloads))
    for path in paths:
        signal = SignalMap('/t', ODD, path)
        expected = [signal.read(TYPES.deserialize_cdr(p, ODD)) for p in payloads]
        assert columns.present[path].tolist() == [value is not None for value in expected]
        found = columns.values[path][columns.present[path]]
        assert found.tolist() == [value for value in expected if value is not None]


@given(message=odd(), data=st.data())
def test_damaged_messages_are_told_from_whole_ones(message, data):
    payload = bytes(TYPES.serialize_cdr(message, ODD))
    cut = data.draw(st.integers(0, len(payload) - 1))
    with pytest.raises(CdrError, match='damaged'):
        lay_out(payload[:cut], ODD, TYPES)
    # rclpy's serialize_message leaves some bytes after the end.
    assert lay_out(payload + bytes(9), ODD, TYPES).leaves == lay_out(payload, ODD, TYPES).leaves


def test_joints_without_names_are_refused():
    payload = bytes(STORE.serialize_cdr(STORE.types['std_msgs/msg/Float64MultiArray'](
        STORE.types['std_msgs/msg/MultiArrayLayout']([], 0), np.ones(2)),
        'std_msgs/msg/Float64MultiArray'))
    layout = lay_out(payload, 'std_msgs/msg/Float64MultiArray', STORE)
    assert layout.leaf('data[1]') is not None
    with pytest.raises(CdrError, match='names no joints'):
        layout.leaf('data[rudder]')
