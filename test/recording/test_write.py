import errno
from itertools import pairwise

from bags_by_hand import rig, STORE, write_bag
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

for library in ('mcap', 'mcap_ros2'):       # which have no rosdep key
    pytest.importorskip(library)

from mcap.reader import make_reader  # noqa: E402,I100
from mcap_ros2.decoder import DecoderFactory  # noqa: E402

from hydro_twin.errors import BagError, DataError  # noqa: E402
from hydro_twin.recording.bag import read_signals  # noqa: E402
from hydro_twin.recording.read import read_recording  # noqa: E402
from hydro_twin.recording.series import Series, StampedSeries  # noqa: E402
from hydro_twin.recording.signals import load_signals, SignalMap  # noqa: E402
from hydro_twin.recording.write import add_to_copy, write_recording  # noqa: E402

NAMES = ('u_m', 'theta_d', 'T_g')
START = 1_700_000_000_123_456_789


def signals():
    return load_signals('load_simulator', NAMES)


def some_series(lengths=(40, 25), start=START, sample_time=0.002, seed=0, names=NAMES):
    rng = np.random.default_rng(seed)
    made = []
    for length in lengths:
        made.append(Series({name: rng.standard_normal(length) for name in names}, sample_time,
                           start))
        start += round(length * sample_time * 1e9) + 10**9
    return made


def assert_same(found, expected):
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        assert (a.start, a.sample_time) == (b.start, b.sample_time)
        assert {n: c.tobytes() for n, c in a.columns.items()} == {
            n: c.tobytes() for n, c in b.columns.items()}


@settings(max_examples=25, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lengths=st.lists(st.integers(10, 60), min_size=1, max_size=3),
       start=st.integers(1, 2 * 10**18), sample_time=st.sampled_from([0.002, 0.001, 1 / 300]),
       suffix=st.sampled_from(['', '.mcap', '.db3']), seed=st.integers(0, 9))
def test_series_to_bag_to_series(tmp_path_factory, lengths, start, sample_time, suffix, seed):
    path = tmp_path_factory.mktemp('round') / f'bag{suffix}'
    series = some_series(lengths, start, sample_time, seed)
    write_recording(path, series, signals())
    assert path.is_file() == bool(suffix)
    assert_same(read_recording([path], signals(), ['u_m'], sample_time).series, series)


@settings(max_examples=15, deadline=None)
@given(steps=st.lists(st.lists(st.integers(1, 10**9), min_size=1, max_size=30), min_size=1,
                      max_size=3),
       suffix=st.sampled_from(['', '.mcap', '.db3']))
def test_stamped_series_to_bag_to_samples(tmp_path_factory, steps, suffix):
    path = tmp_path_factory.mktemp('round') / f'bag{suffix}'
    stamps = START + np.cumsum(np.concatenate(steps))
    rng = np.random.default_rng(len(stamps))
    columns = {name: rng.standard_normal(len(stamps)) for name in NAMES}
    cuts = np.cumsum([0, *map(len, steps)])
    write_recording(path, [StampedSeries({n: c[a:b] for n, c in columns.items()}, stamps[a:b])
                           for a, b in pairwise(cuts)], signals())
    for name, samples in read_signals(path, signals()).items():
        assert samples.stamped
        assert samples.stamps.tolist() == stamps.tolist()
        assert samples.values.tobytes() == columns[name].tobytes()


def test_bag_reads_back_with_the_reference_library(tmp_path):
    (series,) = some_series([30])
    write_recording(tmp_path / 'bag.mcap', [series], signals())
    rows = {'/load_simulator/command': [], '/load_simulator/joint_states': []}
    with (tmp_path / 'bag.mcap').open('rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, ros in reader.iter_decoded_messages():
            time = ros.header.stamp.sec * 10**9 + ros.header.stamp.nanosec
            assert time == message.log_time
            rows[channel.topic].append((time, list(ros.name), list(ros.position),
                                        list(ros.effort)))
    times = [START + 2_000_000 * k for k in range(30)]
    assert rows['/load_simulator/command'] == [
        (t, ['u_m'], [u], []) for t, u in zip(times, series['u_m'], strict=True)]
    assert rows['/load_simulator/joint_states'] == [
        (t, ['theta_d'], [a], [T])
        for t, a, T in zip(times, series['theta_d'], series['T_g'], strict=True)]


def test_any_field_scale_and_type(tmp_path):
    maps = {
        'a': SignalMap('/joints', 'sensor_msgs/msg/JointState', 'position[rudder]', 0.5, 3.0),
        'b': SignalMap('/joints', 'sensor_msgs/msg/JointState', 'effort[elevator]'),
        'c': SignalMap('/joints', 'sensor_msgs/msg/JointState', 'position[elevator]'),
        'd': SignalMap('/wrench', 'geometry_msgs/msg/WrenchStamped', 'wrench.torque.z', -2.0),
        'e': SignalMap('/count', 'std_msgs/msg/Int32', 'data'),
        'f': SignalMap('/many', 'std_msgs/msg/Float32MultiArray', 'data[2]'),
        'g': SignalMap('/imu', 'sensor_msgs/msg/Imu', 'orientation_covariance[4]'),
        'h': SignalMap('/tf', 'tf2_msgs/msg/TFMessage', 'transforms[1].transform.rotation.w'),
        'i': SignalMap('/on', 'std_msgs/msg/Bool', 'data'),
    }
    (series,) = some_series([50], names=list(maps))
    series.columns['e'][:] = np.arange(-25, 25)
    series.columns['f'][:] = series['f'].astype(np.float32)
    series.columns['i'][:] = np.arange(50) % 2
    write_recording(tmp_path / 'bag.db3', [series], maps)
    (found,) = read_recording([tmp_path / 'bag.db3'], maps, ['e'], 0.002).series
    for name, signal in maps.items():
        if signal.type not in ('std_msgs/msg/Int32', 'std_msgs/msg/Float32MultiArray',
                               'tf2_msgs/msg/TFMessage', 'std_msgs/msg/Bool'):
            np.testing.assert_allclose(found[name], series[name], rtol=1e-14, err_msg=name)
    with AnyReader([tmp_path / 'bag.db3']) as reader:
        seen = {name: [] for name in maps}
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            for name, signal in maps.items():
                if signal.topic == connection.topic:
                    seen[name].append(signal.read(message))
    for name in maps:
        np.testing.assert_allclose(seen[name], series[name], rtol=1e-14, err_msg=name)


def test_what_the_bag_says_of_its_origin(tmp_path):
    write_recording(tmp_path / 'bag', some_series(), signals(), {'origin': 'a rig of ours'})
    with AnyReader([tmp_path / 'bag']) as reader:
        assert reader.readers[0].storage.metadata.custom == {'origin': 'a rig of ours'}


@pytest.mark.parametrize('path', ['bag', 'bag.mcap', 'bag.db3'])
def test_nothing_is_overwritten_or_left_half_done(tmp_path, path):
    write_recording(tmp_path / path, some_series(), signals())
    before = sorted(tmp_path.rglob('*'))
    with pytest.raises(BagError, match='exists already'):
        write_recording(tmp_path / path, some_series(), signals())
    with pytest.raises(BagError, match='no folder'):
        write_recording(tmp_path / 'absent' / path, some_series(), signals())
    with pytest.raises(KeyError):
        write_recording(tmp_path / f'other_{path}', some_series(names=['u_m']), signals())
    with pytest.raises(DataError, match='follow'):
        write_recording(tmp_path / f'other_{path}', some_series()[::-1], signals())
    with pytest.raises(BagError, match='no standard message odd_msgs'):
        write_recording(tmp_path / f'other_{path}', some_series(), signals() | {
            'u_m': SignalMap('/u', 'odd_msgs/msg/Odd', 'data')})
    with pytest.raises(BagError, match='cannot carry'):
        write_recording(tmp_path / f'other_{path}', some_series(), signals() | {
            'u_m': SignalMap('/load_simulator/joint_states', 'std_msgs/msg/Float64', 'data')})
    assert sorted(tmp_path.rglob('*')) == before


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_copy_holds_the_input_and_the_prediction_beside(tmp_path, storage):
    messages = rig(100)
    source = write_bag(tmp_path / 'source', messages, storage)
    command = SignalMap('/command', 'sensor_msgs/msg/JointState', 'position[0]')
    prediction = SignalMap('/twin/prediction', 'sensor_msgs/msg/JointState', 'effort[0]')
    series = Series({'T': np.arange(60.0)}, 0.002, 10**18 + 20_000_000)
    add_to_copy(source, tmp_path / 'out', [series], {'T': prediction}, beside=command)
    with AnyReader([tmp_path / 'out']) as reader:
        copied = [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()]
    assert [row for row in copied if row[0] != '/twin/prediction'] == [
        (topic, t, bytes(STORE.serialize_cdr(m, m.__msgtype__))) for topic, t, m in messages]
    # The command is received 0.1 ms after its stamp, and so is what was added beside it.
    assert [t for topic, t, _ in copied if topic == '/twin/prediction'] == [
        10**18 + 20_000_000 + k * 2_000_000 + 100_000 for k in range(60)]
    (found,) = read_recording([tmp_path / 'out'], {'u': command, 'T': prediction}, ['u'],
                              0.002).series
    assert_same([Series({'T': found['T']}, 0.002, found.start)], [series])
    with pytest.raises(BagError, match='already has /twin/prediction'):
        add_to_copy(tmp_path / 'out', tmp_path / 'again', [series], {'T': prediction}, command)
    assert not (tmp_path / 'again').exists()


def test_a_full_disk_is_an_error_of_the_bag(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('rosbags.rosbag2.Writer.write', full)
    with pytest.raises(OSError, match='No space left') as caught:
        write_recording(tmp_path / 'bag', some_series(), signals())
    assert caught.value.filename == str(tmp_path / 'bag')
    assert not list(tmp_path.iterdir())
