"""Manifests: what a row stands for, and that every fault is said before anything runs."""
import json
from pathlib import Path

from fleet_by_hand import broken, manifest, PLANT, record
import pytest

from hydro_twin.commands.main import main
from hydro_twin.errors import UserError
from hydro_twin.fleet.manifest import ManifestError, read_manifest


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('rigs')
    for k, name in enumerate(('a_1', 'a_2', 'b_1')):
        record(folder, name, k)
    broken(folder, 'c_1')
    (folder / 'config.yaml').write_text(
        f'/**:\n  ros__parameters:\n    plant: {PLANT}\n', 'utf-8')
    return folder


def later(folder, name, seconds):
    """Copy a bag to one that begins later."""
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(folder / 'a_1') as reader, Writer(
            folder / name, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store)
                  for c in reader.connections}
        for connection, stamp, raw in reader.messages():
            writer.write(topics[connection.id], stamp + seconds * 10 ** 9, raw)


def test_a_row_with_a_date_is_one_period_with_all_its_bags(folder):
    path = manifest(folder, ['rig b,control_valve,b_*,2026-02,,east',
                             'rig a,control_valve,a_1; a_2,2026-01-15,old,west'],
                    columns='name,plant,bags,date,group,site')
    b, a = read_manifest(path)
    assert (b.rig, b.date, b.group, b.labels) == ('rig b', '2026-02-01', PLANT,
                                                  (('site', 'east'),))
    assert (a.rig, a.date, a.group) == ('rig a', '2026-01-15', 'old')
    assert a.bags == tuple((folder / name).resolve() for name in ('a_1', 'a_2'))


def test_each_bag_may_be_a_period_and_all_are_in_order_of_time(folder):
    later(folder, 'd_1', 2 * 86400)
    later(folder, 'd_2', 86400)
    each = read_manifest(manifest(folder, ['d,control_valve,d_*,each']))
    assert [task.bags[0].name for task in each] == ['d_2', 'd_1']
    assert [task.date[:10] for task in each] == ['1970-01-02', '1970-01-03']
    (one,) = read_manifest(manifest(folder, ['d,control_valve,d_*,']))
    assert [bag.name for bag in one.bags] == ['d_2', 'd_1']
    assert one.date == each[0].date


def test_periods_of_a_rig_are_in_order_of_time(folder):
    path = manifest(folder, ['a,control_valve,a_2,2026-03', 'b,control_valve,b_1,2026-01',
                             'a,control_valve,a_1,2025'])
    assert [(task.rig, task.date) for task in read_manifest(path)] == [
        ('a', '2025-01-01'), ('a', '2026-03-01'), ('b', '2026-01-01')]


def test_a_group_is_of_one_plant(folder):
    path = manifest(folder, ['a,control_valve,a_1,x', 'b,cylinder,b_1,x'],
                    columns='name,plant,bags,group')
    with pytest.raises(ManifestError, match='group x has rigs of control_valve and cylinder'):
        read_manifest(path)


def test_yaml_says_the_same(folder):
    table = read_manifest(manifest(
        folder, ['a,control_valve,a_1;a_2,2026-01-15,x,config.yaml'],
        columns='name,plant,bags,date,group,config'))
    (folder / 'fleet.yaml').write_text('rigs:\n- {name: a, plant: control_valve, bags: [a_1, a_2],'
                                       ' date: 2026-01-15, group: x, config: config.yaml}\n')
    assert read_manifest(folder / 'fleet.yaml') == table
    (folder / 'load.yaml').write_text(json.dumps([
        {'name': 'a', 'plant': 'load_simulator', 'bags': 'a_1', 'constants': {'D_m': 3e-5}}]))
    csv = manifest(folder, ['a,load_simulator,a_1,D_m=3e-5'],
                   columns='name,plant,bags,constants')
    assert read_manifest(folder / 'load.yaml') == read_manifest(csv)
    assert read_manifest(csv)[0].constants == (('D_m', 3e-5),)


def test_a_broken_bag_is_no_fault_of_the_manifest(folder):
    (task,) = read_manifest(manifest(folder, ['c,control_valve,c_1,']))
    assert task.bags == ((folder / 'c_1').resolve(),)
    assert task.date == ''


@pytest.mark.parametrize(('row', 'says'), [
    ('a,no_plant,a_1,', "no plant 'no_plant'"),
    ('a,control_valve,nothing_*,', "nothing matches 'nothing_*'"),
    ('a,control_valve,runs/**.mcap,', "'runs/**.mcap' is no pattern of files"),
    ('a,control_valve,.,', "nothing matches '.'"),
    ('a,control_valve,a_1,May', "date 'May' should read like"),
    ('a,control_valve,a_1,2026-13', "date '2026-13' should read like"),
    (',control_valve,a_1,', 'lacks name'),
    ('a,control_valve,a_1', 'not as many cells'),
    ('a,control_valve,a_1,2026\na,control_valve,a_2,2026', 'more than one row of the date'),
    ('a,control_valve,a_1,2025\na,control_valve,a_*,2026', 'in more than one period'),
    ('a,control_valve,a_1,2025\na,valve_servo,a_2,2026', 'more than one plant'),
    ('', 'has no rows'),
])
def test_a_fault_is_one_line_and_nothing_runs(folder, tmp_path, capsys, row, says):
    path = manifest(folder, [row], 'faulty.csv')
    assert main(['fleet', str(path), '-o', str(tmp_path / 'out')]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert str(path) in line
    assert not (tmp_path / 'out').exists()


def test_every_fault_has_its_line(folder, tmp_path, capsys):
    path = manifest(folder, ['a,no_plant,a_1,,,', 'b,load_simulator,b_1,,x=1,',
                             'c,control_valve,a_2,,,absent.yaml', 'd,control_valve,b_1,,,'],
                    columns='name,plant,bags,date,constants,config')
    assert main(['fleet', str(path), '-o', str(tmp_path / 'out')]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [f'line {k}' in line for k, line in enumerate(lines, 2)] == [True] * 3
    assert 'has no constant x' in lines[1]
    assert 'absent.yaml' in lines[2]


def test_what_is_no_manifest_is_refused(folder):
    for name, text in (('a.csv', 'rig,bags\n'), ('a.yaml', 'a: 1\n'), ('b.yaml', '{'),
                       ('c.csv', '')):
        (folder / name).write_text(text, 'utf-8')
        with pytest.raises(UserError, match=name):
            read_manifest(folder / name)
    with pytest.raises(UserError, match='No such file'):
        read_manifest(Path(folder / 'absent.csv'))
    assert issubclass(ManifestError, UserError)
