"""Tests of message types: fields that a type has or has not, and types that rosbags lacks."""
import sys
from types import ModuleType

import pytest

from hydro_twin.errors import UserError
from hydro_twin.live.messages import check_field, learn, typestore
from hydro_twin.live.reader import Reader
from hydro_twin.recording.signals import SignalMap

JOINTS = 'sensor_msgs/msg/JointState'


@pytest.mark.parametrize(('kind', 'field'), [
    (JOINTS, 'position[0]'), (JOINTS, 'effort[rudder]'), (JOINTS, 'header.stamp.sec'),
    ('std_msgs/msg/Float64', 'data'), ('std_msgs/msg/Float64MultiArray', 'data[7]'),
    ('geometry_msgs/msg/WrenchStamped', 'wrench.torque.z'),
    ('geometry_msgs/msg/PoseWithCovariance', 'covariance[35]'),
    ('tf2_msgs/msg/TFMessage', 'transforms[0].transform.translation.x')])
def test_fields_that_there_are_pass(kind: str, field: str) -> None:
    check_field(SignalMap('/x', kind, field))


@pytest.mark.parametrize(('kind', 'field', 'said'), [
    (JOINTS, 'position[0].x', 'it has header.stamp.sec, header.stamp.nanosec, position'),
    (JOINTS, 'position', 'position[]'),
    (JOINTS, 'pos[0]', 'no number'),
    (JOINTS, 'header.frame_id', 'no number'),
    (JOINTS, 'name[0]', 'no number'),
    ('geometry_msgs/msg/PoseWithCovariance', 'covariance[36]', '36 numbers'),
    ('std_msgs/msg/Float64MultiArray', 'data[rudder]', 'write data[0]')])
def test_fields_that_no_message_can_have_are_refused(kind: str, field: str, said: str) -> None:
    with pytest.raises(UserError, match=r'\A.*\Z') as caught:
        check_field(SignalMap('/x', kind, field))
    assert said in str(caught.value)


def test_a_type_that_rosbags_lacks_is_learned_from_its_class(
        monkeypatch: pytest.MonkeyPatch) -> None:
    rosidl = pytest.importorskip('rosidl_parser.definition')

    class Valve:
        SLOT_TYPES = (rosidl.NamespacedType(['std_msgs', 'msg'], 'Header'),
                      rosidl.Array(rosidl.BasicType('double'), 2),
                      rosidl.UnboundedSequence(rosidl.UnboundedString()),
                      rosidl.BasicType('boolean'), rosidl.BasicType('float'))

        @staticmethod
        def get_fields_and_field_types() -> dict[str, str]:
            return dict.fromkeys(['header', 'pressure', 'name', 'open', 'travel'], '')

    module = ModuleType('my_rig.msg')
    module.Valve = Valve   # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, 'my_rig', ModuleType('my_rig'))
    monkeypatch.setitem(sys.modules, 'my_rig.msg', module)
    where = SignalMap('/x', 'my_rig/msg/Valve', 'travel')
    check_field(where)
    with pytest.raises(UserError, match='2 numbers'):
        check_field(SignalMap('/x', 'my_rig/msg/Valve', 'pressure[2]'))
    store, (header, time) = typestore(), ('std_msgs/msg/Header', 'builtin_interfaces/msg/Time')
    import numpy as np
    message = store.types['my_rig/msg/Valve'](
        header=store.types[header](stamp=store.types[time](sec=3, nanosec=4), frame_id='a'),
        pressure=np.array([1.0, 2.0]), name=['bc'], open=True, travel=0.5)
    payload = bytes(store.serialize_cdr(message, 'my_rig/msg/Valve'))
    assert Reader([where]).read(payload) == (3_000_000_004, [0.5])


def test_a_type_that_is_not_installed_is_refused() -> None:
    with pytest.raises(UserError, match='is not installed'):
        learn('no_such_package/msg/Valve')
