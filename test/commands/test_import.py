import gzip
import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from hydro_twin.api import read as ht_read
from hydro_twin.commands.main import main
from hydro_twin.plants import plant_named
from hydro_twin.recording.bag import read_signals
from hydro_twin.recording.read import read_recording
from hydro_twin.recording.signals import load_signals
from hydro_twin.share import share_folder

DATA = Path(os.environ.get('HYDRO_TWIN_DATA', 'absent'))
measured = pytest.mark.skipif(not DATA.is_dir(), reason='HYDRO_TWIN_DATA names no folder')


def read(path, plant_name, sample_time):
    plant = plant_named(plant_name)
    signals = load_signals(plant_name, [s.name for s in plant.signals])
    held = [s.name for s in plant.inputs if s.held]
    return read_recording([path], signals, held, sample_time).series


def map_file(name):
    return str(share_folder() / 'config' / 'measured' / f'{name}.yaml')


def test_table_to_bag_and_back(tmp_path, capsys):
    table = tmp_path / 'table.csv'
    table.write_text('t,u,x\n' + ''.join(f'{0.002 * k:.3f},{k % 7},{k * k}\n' for k in range(50)))
    (tmp_path / 'map.yaml').write_text(
        'plant: cylinder\norigin: a test\ntime: t\n'
        'signals: {command: u, x: {column: x, unit: mm}}\n')
    arguments = ['import', str(table), '-o', str(tmp_path / 'bag'), '--map',
                 str(tmp_path / 'map.yaml')]
    assert main([*arguments, '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == {
        'bag': str(tmp_path / 'bag'), 'plant': 'cylinder', 'tables': 1, 'series': 1, 'samples': 50,
        'rate': 500.0, 'periods': dict.fromkeys(('p5', 'median', 'p95', 'longest'), 0.002),
        'signals': {'command': {'unit': '1', 'min': 0.0, 'max': 6.0},
                    'x': {'unit': 'm', 'min': 0.0, 'max': 49 * 49 * 1e-3}}}
    (series,) = read(tmp_path / 'bag', 'cylinder', 0.002)
    assert series['command'].tolist() == [k % 7 for k in range(50)]
    np.testing.assert_allclose(series['x'], np.arange(50) ** 2 * 1e-3, rtol=1e-14)

    assert main(arguments) == 2
    assert 'exists already' in capsys.readouterr().err


def test_a_sensor_may_be_in_the_table_and_missing_in_some_rows(tmp_path, capsys):
    (tmp_path / 'table.csv').write_text('t,u,x,v\n' + ''.join(
        f'{0.002 * k:.3f},{k % 7},{k * k},{k if k < 20 else "nan"}\n' for k in range(50)))
    (tmp_path / 'map.yaml').write_text(
        'plant: cylinder\ntime: t\nsignals: {command: u, x: x, v: {column: v, unit: mm/s}}\n')
    assert main(['import', str(tmp_path / 'table.csv'), '-o', str(tmp_path / 'bag'), '--map',
                 str(tmp_path / 'map.yaml'), '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    assert result['signals']['v'] == pytest.approx({'unit': 'm/s', 'min': 0.0, 'max': 0.019})
    (series,) = ht_read(tmp_path / 'bag', 'cylinder').recording.series
    assert len(series) == 50
    np.testing.assert_allclose(series['v'][:20], 1e-3 * np.arange(20))
    assert np.isnan(series['v'][20:]).all()


@pytest.mark.filterwarnings('error')
def test_a_sensor_may_be_missing_in_some_tables_or_in_all(tmp_path, capsys):
    for name, values in (('a', ['nan'] * 20), ('b', range(20))):
        (tmp_path / f'{name}.csv').write_text('t,u,x,v\n' + ''.join(
            f'{0.002 * k:.3f},{k % 7},{k * k},{v}\n' for k, v in enumerate(values)))
    (tmp_path / 'map.yaml').write_text(
        'plant: cylinder\ntime: t\nsignals: {command: u, x: x, v: v}\n')
    arguments = ['--map', str(tmp_path / 'map.yaml'), '--json']
    a, b = str(tmp_path / 'a.csv'), str(tmp_path / 'b.csv')
    assert main(['import', a, b, '-o', str(tmp_path / 'both'), *arguments]) == 0
    signals = json.loads(capsys.readouterr().out)['signals']
    assert signals['v'] == {'unit': 'm/s', 'min': 0.0, 'max': 19.0}
    assert main(['import', a, '-o', str(tmp_path / 'one'), *arguments]) == 0
    assert json.loads(capsys.readouterr().out)['signals'].keys() == {'command', 'x'}
    (series,) = ht_read(tmp_path / 'one', 'cylinder').recording.series
    assert series.columns.keys() == {'command', 'x'}


@pytest.mark.parametrize(('text', 'says'), [
    ('plant: rocket\ntime: t\nsignals: {x: x}', "no plant 'rocket'"),
    ('plant: cylinder\ntime: t\nsignals: {x: x}', 'the signals of cylinder are command, x'),
    ('plant: cylinder\ntime: t\nsignals: {x: x, command: u}', 'no such table'),
    ('plant: cylinder\ntime: t\nsignals: {x: {column: x, unit: deg}, command: u}',
     'map.yaml: signal x: deg cannot be converted to m; units for it are m, cm, mm, um'),
    ('plant: cylinder\ntime: t\nrows: [5, 2]\nsignals: {x: x, command: u}', 'map.yaml: rows must'),
])
def test_mistakes_leave_one_line_and_no_bag(tmp_path, capsys, text, says):
    (tmp_path / 'map.yaml').write_text(text)
    assert main(['import', str(tmp_path / 'absent.csv'), '-o', str(tmp_path / 'bag'), '--map',
                 str(tmp_path / 'map.yaml')]) == 2
    said = capsys.readouterr()
    assert says in said.err
    assert said.err.count('\n') == 1
    assert not said.out
    assert not (tmp_path / 'bag').exists()


def unsteady(tmp_path, name, rate=20.0, length=300, seed=0, spread=0.4):
    """Write a table sampled unevenly, return it with its times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(1 - spread, 1 + spread, length)).round(6) / rate
    (tmp_path / name).write_text('t,u,x\n' + ''.join(
        f'{t!r},{k},{float(np.sin(t))!r}\n' for k, t in enumerate(times.tolist())))
    return str(tmp_path / name), times


def unsteady_map(tmp_path, more=''):
    (tmp_path / 'map.yaml').write_text(
        f'plant: cylinder\ntime: t\n{more}\nsignals: {{command: {{column: u, unit: V}}, x: x}}\n')
    return ['--map', str(tmp_path / 'map.yaml')]


@pytest.mark.parametrize('suffix', ['', '.mcap', '.db3'])
def test_unsteady_tables_come_back_with_their_own_stamps(tmp_path, capsys, suffix):
    made = [unsteady(tmp_path, f'{k}.csv', seed=k, length=250 + k) for k in range(3)]
    bag = tmp_path / f'bag{suffix}'
    assert main(['import', *(table for table, _ in made), '-o', str(bag), '--json',
                 *unsteady_map(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    pauses = np.concatenate([np.diff(times) for _, times in made])
    assert (result['tables'], result['series'], result['samples']) == (3, 3, 753)
    assert result['rate'] == pytest.approx(1 / np.median(pauses), rel=1e-6)
    assert result['periods'] == pytest.approx({
        'p5': np.percentile(pauses, 5), 'median': np.median(pauses),
        'p95': np.percentile(pauses, 95), 'longest': pauses.max()}, rel=1e-6)
    assert result['signals']['command'] == {'unit': 'V', 'min': 0.0, 'max': 251.0}

    signals = load_signals('cylinder', ['command', 'x'])
    found = read_signals(bag, signals)
    first = 0
    for _, times in made:
        for name, values in (('command', np.arange(len(times))), ('x', np.sin(times))):
            stamps = found[name].stamps[first:first + len(times)]
            np.testing.assert_allclose(stamps - stamps[0], 1e9 * (times - times[0]), atol=1)
            assert found[name].values[first:first + len(times)].tolist() == values.tolist()
        first += len(times)
    assert len(read_recording([bag], signals, ['command'], 0.05).series) == 3


def test_an_unsteady_rate_is_said_to_be_one(tmp_path, capsys):
    table, _ = unsteady(tmp_path, 'a.csv')
    assert main(['import', table, '-o', str(tmp_path / 'bag'), *unsteady_map(tmp_path)]) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert '300 samples in 1 series' in said
    assert 'unevenly: nine periods of ten are 3' in said
    table, _ = unsteady(tmp_path, 'b.csv', spread=0.0)
    assert main(['import', table, '-o', str(tmp_path / 'even'), *unsteady_map(tmp_path)]) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert ' 20 Hz' in said
    assert 'unevenly' not in said


def test_a_slow_table_is_not_mixed_with_fast_ones(tmp_path, capsys):
    """The reader takes pauses of five typical periods for gaps: of the slow one all would be."""
    fast, _ = unsteady(tmp_path, 'fast.csv', 500.0, 1000)
    slow, _ = unsteady(tmp_path, 'slow.csv', 20.0)
    assert main(['import', fast, slow, '-o', str(tmp_path / 'bag'), *unsteady_map(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert 'slow.csv has a sample every 0.05' in said
    assert 'a bag of its own' in said
    assert not (tmp_path / 'bag').exists()


def test_runs_sampled_slowly_stay_apart(tmp_path):
    """At one sample in 10 s a pause of 10 s between runs would be no pause."""
    made = [unsteady(tmp_path, f'{k}.csv', 0.1, 40, spread=0.1)[0] for k in range(2)]
    assert main(['import', *made, '-o', str(tmp_path / 'bag'), *unsteady_map(tmp_path)]) == 0
    assert len(read(tmp_path / 'bag', 'cylinder', 10.0)) == 2


def test_a_table_without_order_is_no_recording(tmp_path, capsys):
    rows = ''.join(f'{-k},1,2\n' for k in range(30))
    (tmp_path / 'a.csv').write_text(f't,u,x\n{rows}')
    assert main(['import', str(tmp_path / 'a.csv'), '-o', str(tmp_path / 'bag'),
                 *unsteady_map(tmp_path)]) == 2
    assert 'no 10 rows follow each other in time' in capsys.readouterr().err


@measured
@pytest.mark.parametrize('joint', ['Boom', 'Stick', 'Bucket'])
def test_excavator_set(tmp_path, capsys, joint):
    tables = [DATA / 'excavator' / f'manual_mitch_{day}.csv.gz'
              for day in ('1101_2333', '1102_1814')]
    assert main(['import', *map(str, tables), '-o', str(tmp_path / 'bag'), '--json', '--map',
                 map_file(f'excavator_{joint.lower()}')]) == 0
    result = json.loads(capsys.readouterr().out)
    # The last row of the second log is cut short, and has no value of its last column.
    lines = [gzip.decompress(table.read_bytes()).splitlines() for table in tables]
    content = [np.genfromtxt(rows, delimiter=',', names=True)
               for rows in (lines[0], lines[1][:-1])]
    assert (result['series'], result['samples']) == (2, sum(map(len, content)))
    assert result['rate'] == pytest.approx(18.83, abs=0.01)
    found = read_signals(tmp_path / 'bag', load_signals('cylinder', ['command', 'x']))
    pauses = np.concatenate([np.diff(c['Time']) for c in content])
    steps = np.delete(np.diff(found['x'].stamps), len(content[0]) - 1)
    np.testing.assert_allclose(steps, 1e9 * pauses, atol=2)
    np.testing.assert_allclose(
        found['x'].values, 0.01 * np.concatenate([c[f'{joint}_Ms'] for c in content]), rtol=1e-14)
    command = np.concatenate([c[f'{joint}_Cmd'] for c in content])
    np.testing.assert_allclose(found['command'].values, command - command[0], atol=1e-12)
    assert len(read(tmp_path / 'bag', 'cylinder', 0.05)) == 2


@measured
def test_servo_valve_cylinder_set(tmp_path, capsys):
    tables = sorted(map(str, (DATA / 'servo_valve_cylinder').glob('*.csv.gz')))
    assert main(['import', *tables, '-o', str(tmp_path / 'bag'), '--json', '--map',
                 map_file('servo_valve_cylinder')]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result['tables'], result['series'], result['rate']) == (5, 5, 1000.0)
    assert result['signals']['command']['unit'] == 'V'
    found = read(tmp_path / 'bag', 'cylinder', 0.001)
    for series, table in zip(found, tables, strict=True):
        content = np.genfromtxt(table, delimiter=',', names=True)[1:]
        assert series['command'].tolist() == content['command_V'].tolist()
        np.testing.assert_allclose(series['x'], 1e-3 * content['position_mm'], rtol=1e-14)


@measured
@pytest.mark.parametrize('name', ['DATA_EMPS', 'DATA_EMPS_PULSES'])
def test_positioning_set(tmp_path, name):
    table = DATA / 'positioning' / f'{name}.mat'
    assert main(['import', str(table), '-o', str(tmp_path / 'bag'), '--map',
                 map_file('positioning')]) == 0
    (series,) = read(tmp_path / 'bag', 'positioning', 0.001)
    content = loadmat(table)
    assert series['x'].tobytes() == content['qm'].ravel().tobytes()
    np.testing.assert_allclose(series['force'], 35.15065188 * content['vir'].ravel(), rtol=1e-9)


@measured
@pytest.mark.parametrize(('name', 'table', 'plant', 'rate', 'count', 'columns'), [
    ('eha', 'eha/load1_stroke25mm.csv.gz', 'cylinder', 1000, 31000,
     {'command': ('pump_speed_rpm', 1.0), 'x': ('position_mm', 1e-3)}),
    ('leg', 'leg/policy1_sin1Hz.csv.gz', 'load_simulator', 500, 20000,
     {'u_m': ('force_command_N', 1.0), 'theta_d': ('joint_angle_rad', 1.0),
      'T_g': ('force_N', 1.0)}),
    ('water_valve', 'water_valve/actuator3_2001-10-11_1h.csv.gz', 'control_valve', 1, 3600,
     {'command': ('LC74_20CV_pct', 0.01), 'opening': ('L74_20X_pct', 0.01)}),
])
def test_other_measured_sets(tmp_path, name, table, plant, rate, count, columns):
    assert main(['import', str(DATA / table), '-o', str(tmp_path / 'bag.mcap'), '--map',
                 map_file(name)]) == 0
    (series,) = read(tmp_path / 'bag.mcap', plant, 1 / rate)
    content = np.genfromtxt(DATA / table, delimiter=',', names=True)
    assert len(series) == len(content) == count
    for signal, (column, scale) in columns.items():
        np.testing.assert_allclose(series[signal], scale * content[column], rtol=1e-14)


def test_rows_between_gaps_do_not_make_a_table_slow(tmp_path):
    """Two rows 50.2 ms apart: no gap by the median of all rows, but by that of those kept."""
    pauses = np.r_[[9.9] * 104, [10.1] * 100, [1000.0, 50.2] * 4]
    (tmp_path / 'a.csv').write_text('t,u,x\n' + ''.join(
        f'{t!r},{k},{float(np.sin(t))!r}\n'
        for k, t in enumerate(np.cumsum(np.r_[0.0, pauses]).round(1).tolist())))
    command = ['import', str(tmp_path / 'a.csv'), '-o', str(tmp_path / 'bag')]
    map_ = ['--map', str(tmp_path / 'map.yaml')]
    unsteady_map(tmp_path)
    text = (tmp_path / 'map.yaml').read_text()
    (tmp_path / 'map.yaml').write_text(text.replace('time: t', 'time: {column: t, unit: ms}'))
    assert main([*command, *map_]) == 0
