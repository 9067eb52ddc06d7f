import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from hydro_twin.commands.main import main
from hydro_twin.plants import plant_named
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
        'bag': str(tmp_path / 'bag'), 'plant': 'cylinder', 'series': 1, 'samples': 50,
        'rate': 500.0, 'signals': {'command': {'unit': '1', 'min': 0.0, 'max': 6.0},
                                   'x': {'unit': 'm', 'min': 0.0, 'max': 49 * 49 * 1e-3}}}
    (series,) = read(tmp_path / 'bag', 'cylinder', 0.002)
    assert series['command'].tolist() == [k % 7 for k in range(50)]
    np.testing.assert_allclose(series['x'], np.arange(50) ** 2 * 1e-3, rtol=1e-14)

    assert main(arguments) == 2
    assert 'exists already' in capsys.readouterr().err


@pytest.mark.parametrize(('text', 'says'), [
    ('plant: rocket\ntime: t\nsignals: {x: x}', "no plant 'rocket'"),
    ('plant: cylinder\ntime: t\nsignals: {x: x}', 'the signals of cylinder are command, x'),
    ('plant: cylinder\ntime: t\nsignals: {x: x, command: u}', 'no such table'),
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
