import subprocess
import sys
from typing import Any

from bags_by_hand import FLOAT64, float64, header, JOINT_STATE, joint_state, rig, STORE, write_bag
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from hydro_twin.errors import BagError
from hydro_twin.recording.bag import read_signals
from hydro_twin.recording.signals import SignalMap

SIGNALS = {
    'u': SignalMap('/command', JOINT_STATE, 'position[0]'),
    'x': SignalMap('/states', JOINT_STATE, 'position[rudder]', scale=2.0, offset=1.0),
    'T': SignalMap('/states', JOINT_STATE, 'effort[0]'),
}


def deserialised(path, signals):
    """Read by rosbags' own deserialiser and Python attribute access: slow, and independent."""
    result = {name: ([], []) for name in signals}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            for name, signal in signals.items():
                if signal.topic == connection.topic:
                    stamp = message.header.stamp
                    result[name][0].append(stamp.sec * 10**9 + stamp.nanosec)
                    result[name][1].append(signal.read(message))
    return result


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name, (stamps, values) in expected.items():
        assert found[name].stamps.tolist() == stamps
        assert found[name].values.tobytes() == np.array(values).tobytes()


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('compression', ['NONE', 'FILE', 'MESSAGE', 'STORAGE'])
def test_bag_reads_as_rosbags_deserialises(tmp_path, storage, compression):
    if (storage, compression) == ('sqlite3', 'STORAGE'):
        pytest.skip('sqlite3 has no compression of its own')
    path = write_bag(tmp_path / 'bag', rig(), storage, compression)
    assert_same(read_signals(path, SIGNALS), deserialised(path, SIGNALS))


@pytest.mark.parametrize(('storage', 'suffix'), [('mcap', '.mcap'), ('sqlite3', '.db3')])
def test_single_file_reads_as_its_folder(tmp_path, storage, suffix):
    path = write_bag(tmp_path / 'bag', rig(), storage)
    assert_same(read_signals(path / f'bag{suffix}', SIGNALS), deserialised(path, SIGNALS))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bag_split_over_files(tmp_path, storage):
    messages = rig(60)
    suffix = '.mcap' if storage == 'mcap' else '.db3'
    whole = write_bag(tmp_path / 'whole', messages, storage)
    split = write_bag(tmp_path / 'split', messages, storage)
    parts = []
    for k in range(3):
        part = write_bag(tmp_path / f'part{k}', messages[40 * k:40 * (k + 1)], storage)
        parts.append(f'split_{k}{suffix}')
        (part / f'part{k}{suffix}').rename(split / parts[-1])
    (split / f'split{suffix}').unlink()
    metadata = split / 'metadata.yaml'
    text = metadata.read_text().replace(
        f'relative_file_paths:\n  - split{suffix}',
        'relative_file_paths:\n' + '\n'.join(f'  - {part}' for part in parts))
    assert text.count(suffix) == 4
    metadata.write_text(text)
    assert_same(read_signals(split, SIGNALS), deserialised(whole, SIGNALS))


def test_mcap_written_by_the_reference_library_reads_too(tmp_path):
    """Chunks with lz4 and zstd, no chunks, no index, several channels of one topic."""
    from mcap.writer import CompressionType, IndexType, Writer
    messages = rig(40)
    expected = deserialised(write_bag(tmp_path / 'bag', messages), SIGNALS)
    definition = STORE.generate_msgdef(JOINT_STATE)[0].encode()
    for k, options in enumerate((
            {'compression': CompressionType.LZ4, 'chunk_size': 1000},
            {'compression': CompressionType.ZSTD, 'enable_crcs': True},
            {'use_chunking': False},
            {'index_types': IndexType.NONE, 'chunk_size': 1000},
            {'index_types': IndexType.CHUNK | IndexType.METADATA, 'chunk_size': 2000})):
        path = tmp_path / f'reference{k}.mcap'
        with path.open('wb') as file:
            writer = Writer(file, **options)
            writer.start('ros2', 'test')
            schema = writer.register_schema(JOINT_STATE, 'ros2msg', definition)
            channels = {topic: [writer.register_channel(topic, 'cdr', schema) for _ in range(2)]
                        for topic in ('/command', '/states')}
            for n, (topic, time, message) in enumerate(messages):
                writer.add_message(channels[topic][n % 3 == 0], time,
                                   bytes(STORE.serialize_cdr(message, JOINT_STATE)), time)
            writer.finish()
        assert_same(read_signals(path, SIGNALS), expected)


def test_a_signal_may_be_a_stamp(tmp_path):
    messages = [('/states', 5 * 10**9 + k, joint_state((k + 1) * 10**9 + 7, ['shaft'], [0.5]))
                for k in range(20)]
    found = read_signals(write_bag(tmp_path / 'bag', messages), {
        's': SignalMap('/states', JOINT_STATE, 'header.stamp.sec'),
        'x': SignalMap('/states', JOINT_STATE, 'position[0]')})
    assert found['s'].values.tolist() == list(range(1, 21))
    assert found['x'].stamps.tolist() == [k * 10**9 + 7 for k in range(1, 21)]


def test_joints_that_come_and_go_and_swap(tmp_path):
    messages = []
    expected = []
    for k in range(30):
        names = [['rudder', 'shaft'], ['shaft', 'rudder'], ['shaft']][k % 3]
        values = [float(10 * k + len(name)) for name in names]
        messages.append(('/states', k, joint_state(10**9 + k, names, values, frame='f' * (k % 4))))
        if 'rudder' in names:
            expected.append((10**9 + k, values[names.index('rudder')]))
    found = read_signals(write_bag(tmp_path / 'bag', messages), {
        'x': SignalMap('/states', JOINT_STATE, 'position[rudder]')})['x']
    assert list(zip(found.stamps.tolist(), found.values.tolist(), strict=True)) == expected


def test_other_types_and_nested_fields(tmp_path):
    types = STORE.types
    vector = types['geometry_msgs/msg/Vector3']
    messages = []
    for k in range(20):
        time = 5 * 10**9 + k
        wrench = types['geometry_msgs/msg/Wrench'](vector(0., 1., 2.), vector(0., 0., k + 0.5))
        messages.append(('/w', time, types['geometry_msgs/msg/WrenchStamped'](
            header(time), wrench)))
        messages.append(('/i', time, types['std_msgs/msg/Int16'](-k)))
        transform = types['geometry_msgs/msg/TransformStamped'](
            header(time), 'child' * (k % 2), types['geometry_msgs/msg/Transform'](
                vector(0.1 * k, 0., 0.), types['geometry_msgs/msg/Quaternion'](0., 0., 0., 1.)))
        messages.append(('/tf', time, types['tf2_msgs/msg/TFMessage']([transform, transform])))
    found = read_signals(write_bag(tmp_path / 'bag', messages, 'sqlite3'), {
        'torque': SignalMap('/w', 'geometry_msgs/msg/WrenchStamped', 'wrench.torque.z'),
        'count': SignalMap('/i', 'std_msgs/msg/Int16', 'data', scale=-1.0),
        'tf': SignalMap('/tf', 'tf2_msgs/msg/TFMessage', 'transforms[1].transform.translation.x'),
    })
    assert found['torque'].values.tolist() == [k + 0.5 for k in range(20)]
    assert found['torque'].stamped
    assert found['count'].values.tolist() == list(range(20))
    assert not found['count'].stamped
    assert found['tf'].values.tolist() == [0.1 * k for k in range(20)]


def test_headers_without_stamps_leave_receive_times(tmp_path):
    messages = [('/states', 10**9 + k, joint_state(0, ['a'], [float(k)])) for k in range(5)]
    found = read_signals(write_bag(tmp_path / 'bag', messages), {
        'x': SignalMap('/states', JOINT_STATE, 'position[0]')})['x']
    assert found.stamps.tolist() == [10**9 + k for k in range(5)]
    assert not found.stamped


def test_repeated_stamps_count_once_and_optional_topics_may_be_absent(tmp_path):
    messages = [('/states', k, joint_state(10**9 + k // 2, ['a'], [float(k)])) for k in range(6)]
    found = read_signals(
        write_bag(tmp_path / 'bag', messages, types={'/empty': FLOAT64}),
        {'x': SignalMap('/states', JOINT_STATE, 'position[0]'),
         'T': SignalMap('/torque', JOINT_STATE, 'effort[0]'),
         'e': SignalMap('/empty', FLOAT64, 'data')}, optional=['T', 'e'])
    assert found.keys() == {'x'}
    assert found['x'].values.tolist() == [0.0, 2.0, 4.0]


def test_an_optional_signal_may_lack_its_field_or_say_that_it_failed(tmp_path, caplog):
    messages = [('/states', k, joint_state(10**9 + k, ['a'], [float(k) if k < 4 else np.nan]))
                for k in range(6)]
    found = read_signals(
        write_bag(tmp_path / 'bag', messages),
        {'x': SignalMap('/states', JOINT_STATE, 'position[0]'),
         'v': SignalMap('/states', JOINT_STATE, 'velocity[0]'),
         'f': SignalMap('/states', FLOAT64, 'data')}, optional=['x', 'v', 'f'])
    assert found.keys() == {'x'}
    assert found['x'].values.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert 'expects std_msgs/msg/Float64' in caplog.text
    with pytest.raises(BagError, match='not finite'):
        read_signals(tmp_path / 'bag', {'x': SignalMap('/states', JOINT_STATE, 'position[0]')})


def test_reading_needs_neither_rclpy_nor_torch(tmp_path):
    write_bag(tmp_path / 'bag', [('/f', k, float64(1.0)) for k in range(3)])
    program = (
        'import sys, pathlib\n'
        'from hydro_twin.recording.bag import read_signals\n'
        'from hydro_twin.recording.signals import SignalMap\n'
        f'read_signals(pathlib.Path({str(tmp_path / "bag")!r}), '
        "{'f': SignalMap('/f', 'std_msgs/msg/Float64', 'data')})\n"
        'print(*sys.modules)')
    loaded = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                            check=True).stdout.split()
    assert 'hydro_twin.recording.bag' in loaded
    assert not {'rclpy', 'torch', 'scipy', 'numba'} & set(loaded)


def test_a_field_that_only_some_messages_hold_is_refused_by_number(tmp_path):
    messages = [('/states', k, joint_state(10**9 + k, ['a'], [1.0] if k != 7 else []))
                for k in range(10)]
    with pytest.raises(BagError, match=r'message 7 on /states .* 0 numbers in .position.'):
        read_signals(write_bag(tmp_path / 'bag', messages), {
            'x': SignalMap('/states', JOINT_STATE, 'position[0]')})
