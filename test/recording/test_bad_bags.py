"""Whatever is wrong with a bag, one line says so."""
import contextlib
import os
from pathlib import Path
import re
import shutil
import sqlite3
import struct

from bags_by_hand import float64, JOINT_STATE, joint_state, rig, STORE, write_bag
from hypothesis import given, HealthCheck, settings, strategies
import pytest

pytest.importorskip('mcap')     # which has no rosdep key

from mcap import records  # noqa: E402,I100
from mcap.exceptions import EndOfFile, InvalidMagic  # noqa: E402
from mcap.stream_reader import StreamReader  # noqa: E402
from mcap.writer import Writer  # noqa: E402

from hydro_twin.errors import BagError  # noqa: E402
from hydro_twin.recording.bag import opened, read_signals  # noqa: E402
from hydro_twin.recording.read import read_recording  # noqa: E402
from hydro_twin.recording.signals import SignalMap  # noqa: E402

SIGNALS = {'u': SignalMap('/command', JOINT_STATE, 'position[0]'),
           'x': SignalMap('/states', JOINT_STATE, 'position[rudder]')}


def refusal(path, signals=SIGNALS):
    with pytest.raises(BagError) as caught:
        read_signals(path, signals)
    line = str(caught.value)
    assert '\n' not in line
    return line


def test_not_a_bag(tmp_path):
    assert 'no such bag' in refusal(tmp_path / 'absent')
    (tmp_path / 'notes.txt').write_text('hello')
    assert 'not a rosbag2 bag' in refusal(tmp_path / 'notes.txt')
    (tmp_path / 'old.bag').write_text('#ROSBAG V2.0')
    assert 'not a rosbag2 bag' in refusal(tmp_path / 'old.bag')
    (tmp_path / 'folder').mkdir()
    assert 'no metadata.yaml' in refusal(tmp_path / 'folder')
    for name in ('a.mcap', 'a.db3'):
        for content in (b'', b'x', b'not a bag at all' * 10):
            (tmp_path / name).write_bytes(content)
            assert name in refusal(tmp_path / name)
    (tmp_path / 'folder/metadata.yaml').write_text('a: [')
    assert 'folder' in refusal(tmp_path / 'folder')
    (tmp_path / 'folder/metadata.yaml').write_text('a: 1')
    assert 'folder' in refusal(tmp_path / 'folder')


def test_folder_of_a_killed_recorder_names_its_file(tmp_path):
    path = write_bag(tmp_path / 'bag', rig())
    (path / 'metadata.yaml').unlink()
    line = refusal(path)
    assert 'bag.mcap' in line
    assert 'reindex' in line


def test_absent_topic_lists_what_there_is(tmp_path):
    line = refusal(write_bag(tmp_path / 'bag', rig()),
                   {'T': SignalMap('/torque', JOINT_STATE, 'effort[0]')})
    assert '/torque for signal T' in line
    assert '/command (sensor_msgs/msg/JointState, 5' in line
    assert '/states (sensor_msgs/msg/JointState, 5' in line


def test_wrong_type_field_and_joint(tmp_path):
    path = write_bag(tmp_path / 'bag', rig())
    line = refusal(path, {'u': SignalMap('/command', 'std_msgs/msg/Float64', 'data')})
    assert JOINT_STATE in line
    assert 'std_msgs/msg/Float64' in line
    line = refusal(path, {'u': SignalMap('/command', JOINT_STATE, 'data')})
    assert 'position[0..0]' in line
    line = refusal(path, {'u': SignalMap('/command', JOINT_STATE, 'position[1]')})
    assert '1 numbers' in line
    line = refusal(path, {'x': SignalMap('/states', JOINT_STATE, 'effort[elevator]')})
    assert 'shaft, rudder' in line


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_no_messages(tmp_path, storage):
    types = {'/command': JOINT_STATE, '/states': JOINT_STATE}
    assert 'no messages' in refusal(write_bag(tmp_path / 'none', [], storage, types=types))
    half = [message for message in rig() if message[0] == '/command']
    line = refusal(write_bag(tmp_path / 'half', half, storage, types=types))
    assert 'no messages on /states for signal x' in line


@pytest.fixture(scope='module')
def long_bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('bags') / 'bag', rig(10_000))


@pytest.mark.parametrize('keep', [0.02, 0.6, 0.9, 0.999])
@pytest.mark.parametrize('single', [False, True])
def test_mcap_cut_short_tells_how_much_is_left(long_bag, tmp_path, keep, single):
    path = Path(shutil.copytree(long_bag, tmp_path / 'bag'))
    file = path / 'bag.mcap'
    os.truncate(file, int(file.stat().st_size * keep))
    line = refusal(file if single else path)
    assert 'cut short' in line
    assert f'{count_by_reference(file)} messages' in line


def test_mcap_without_chunks_cut_short_tells_how_much_is_left(tmp_path):
    file = tmp_path / 'bag.mcap'
    with file.open('wb') as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start('ros2', 'test')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg',
                                        STORE.generate_msgdef(JOINT_STATE)[0].encode())
        channels = {topic: writer.register_channel(topic, 'cdr', schema)
                    for topic in ('/command', '/states')}
        for topic, time, message in rig(300):
            writer.add_message(channels[topic], time,
                               bytes(STORE.serialize_cdr(message, JOINT_STATE)), time)
        writer.finish()
    os.truncate(file, int(file.stat().st_size * 0.6))
    count = count_by_reference(file)
    assert count > 300
    assert f'{count} messages over {(count // 2 - 1) * 0.002:.1f} s can still be read' in refusal(
        file)


def count_by_reference(file):
    """Count the messages up to the break with the reference library."""
    count = 0
    with file.open('rb') as stream, contextlib.suppress(EndOfFile, InvalidMagic, struct.error):
        for record in StreamReader(stream).records:
            count += isinstance(record, records.Message)
    return count


def test_sqlite_cut_short(tmp_path):
    path = write_bag(tmp_path / 'bag', rig(1000), 'sqlite3')
    file = path / 'bag.db3'
    size = file.stat().st_size
    for keep in (0.9, 0.5, 0.1, 0.01):
        os.truncate(file, int(size * keep))
        assert 'damaged' in refusal(path)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_clock_that_jumps_back(tmp_path, storage):
    late, early = rig(30, start=10**18), rig(30, start=10**18 - 10**9)
    line = refusal(write_bag(tmp_path / 'both', late + early, storage))
    assert 'jump back by 1.058 s at message 30' in line
    sent = [('/command', 10**18 + k, message) for k, (_, _, message) in enumerate(late + early)]
    assert 'the stamps on /command jump back' in refusal(
        write_bag(tmp_path / 'stamps', sent, storage), {'u': SIGNALS['u']})
    plain = [('/u', 10**18 - k, float64(0.0)) for k in range(30)]
    assert 'the receive times on /u jump back' in refusal(
        write_bag(tmp_path / 'received', plain, storage),
        {'u': SignalMap('/u', 'std_msgs/msg/Float64', 'data')})


def test_values_that_are_not_finite(tmp_path):
    messages = [('/command', k, joint_state(10**9 + k, ['a'], [float('nan') if k > 7 else 0.0]))
                for k in range(10)]
    line = refusal(write_bag(tmp_path / 'bag', messages), {'u': SIGNALS['u']})
    assert '2 of 10 values of signal u' in line


def test_damaged_payload_is_named_by_its_number(tmp_path):
    path = write_bag(tmp_path / 'bag', rig(), 'sqlite3')
    for damage in (b'', b'\x00', b'\x07\x00\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 60):
        connection = sqlite3.connect(path / 'bag.db3')
        connection.execute('UPDATE messages SET data = ? WHERE id = 11', (damage,))
        connection.commit()
        connection.close()
        assert 'message 5 on /command' in refusal(path)


def test_count_that_the_metadata_does_not_keep(tmp_path):
    path = write_bag(tmp_path / 'bag', rig(), 'sqlite3')
    connection = sqlite3.connect(path / 'bag.db3')
    connection.execute('DELETE FROM messages WHERE id = 11')
    connection.commit()
    connection.close()
    assert 'promises 50 messages on /command, but holds 49' in refusal(path)


def test_bag_without_a_common_stretch(tmp_path):
    messages = [message for message in rig(200) if message[0] == '/command'] + [
        message for message in rig(200, start=10**18 + 10**12) if message[0] == '/states']
    with pytest.raises(BagError, match='samples in a row'):
        read_recording([write_bag(tmp_path / 'bag', messages)], SIGNALS, ['u'], 0.002)


@pytest.fixture(scope='module', params=[('mcap', 'NONE'), ('mcap', 'STORAGE'), ('mcap', 'MESSAGE'),
                                        ('sqlite3', 'NONE'), ('sqlite3', 'MESSAGE')])
def victim(request, tmp_path_factory):
    storage, compression = request.param
    return write_bag(tmp_path_factory.mktemp('victim') / 'bag', rig(100), storage, compression)


@settings(max_examples=30, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=strategies.data())
def test_any_damage_gives_a_reading_or_one_line(victim, tmp_path, data):
    """Flip bytes anywhere in the file: never another exception than BagError."""
    shutil.rmtree(tmp_path / 'copy', ignore_errors=True)
    copy = shutil.copytree(victim, tmp_path / 'copy')
    file = next(iter([*copy.glob('*.mcap'), *copy.glob('*.db3')]))
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(strategies.integers(1, 4))):
        at = data.draw(strategies.integers(0, len(content) - 1))
        content[at] = data.draw(strategies.integers(0, 255))
    file.write_bytes(content)
    said = ''
    try:
        found = read_signals(copy, SIGNALS)
    except BagError as error:
        said = str(error)
    assert found.keys() == SIGNALS.keys() if not said else '\n' not in said


def test_an_error_of_the_one_who_reads_is_no_damage(tmp_path):
    path = write_bag(tmp_path / 'bag', rig(5))
    with pytest.raises(KeyError, match='of the reader'), opened(path):
        raise KeyError('of the reader')


def test_a_count_that_is_no_number(tmp_path):
    path = write_bag(tmp_path / 'bag', rig(5), 'sqlite3')
    metadata = path / 'metadata.yaml'
    metadata.write_text(re.sub(r'message_count: \d+', 'message_count: x', metadata.read_text()))
    assert 'is damaged' in refusal(path)
    with pytest.raises(BagError, match='is damaged'), opened(path):
        pass


def test_damage_is_named_while_messages_are_read(tmp_path):
    path = write_bag(tmp_path / 'bag', rig(1000), 'mcap', 'STORAGE')
    with (path / 'bag.mcap').open('r+b') as file:
        file.seek((path / 'bag.mcap').stat().st_size // 2)
        file.write(bytes(1000))
    with opened(path) as reader, pytest.raises(BagError, match='is damaged'):
        list(reader.messages())


def test_definition_that_nobody_knows(tmp_path):
    path = write_bag(tmp_path / 'bag', rig(5), 'sqlite3')
    connection = sqlite3.connect(path / 'bag.db3')
    connection.execute("UPDATE topics SET type = 'odd_msgs/msg/Odd'")
    connection.commit()
    connection.close()
    assert STORE.fielddefs.get('odd_msgs/msg/Odd') is None
    line = refusal(path / 'bag.db3', {'u': SignalMap('/command', 'odd_msgs/msg/Odd', 'data')})
    assert 'odd_msgs/msg/Odd' in line
