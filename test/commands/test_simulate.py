import json

import numpy as np
import pytest

from hydro_twin.api import read
from hydro_twin.commands.main import main
from hydro_twin.plants import PLANTS
from hydro_twin.recording import read as read_module
from hydro_twin.recording.signals import load_signals


def simulate(capsys, path, *more, plant='load_simulator'):
    status = main(['simulate', '--plant', plant, '-o', str(path), '--duration', '0.6', '--json',
                   *more])
    out, err = capsys.readouterr()
    return status, json.loads(out) if out else None, err


def columns(path, plant='load_simulator'):
    plant = PLANTS[plant]
    signals = load_signals(plant.name, [signal.name for signal in plant.signals])
    held = {signal.name for signal in plant.signals if signal.held}
    return read_module.read_recording([path], signals, held, plant.sample_time).series


def test_makes_the_three_series_of_the_paper_and_tells_the_truth(tmp_path, capsys):
    status, truth, _ = simulate(capsys, tmp_path / 'bag', '--set', 'J=0.07', '--snr', '40',
                                '--effect', 'friction@motor:coulomb=10')
    assert status == 0
    assert truth['parameters']['J'] == {'value': 0.07, 'unit': 'kg m^2'}
    assert truth['parameters']['G']['value'] == pytest.approx(np.sqrt(7e3 * 1.5e4))
    assert truth['effects'][0]['id'] == 'friction'
    assert truth['effects'][0]['parameters']['coulomb'] == {'value': 10.0, 'unit': 'N m'}
    series = columns(tmp_path / 'bag')
    assert [len(one) for one in series] == [300, 300, 300]
    for one, hertz, stated in zip(series, (1, 7, 9), truth['series'], strict=True):
        amplitude = np.ptp(one['u_m']) / 2 if hertz > 1 else np.abs(one['u_m']).max()
        t = 0.002 * np.arange(300)
        np.testing.assert_allclose(one['u_m'], amplitude * np.sin(2 * np.pi * hertz * t),
                                   atol=0.01 * amplitude)
        assert 50 < np.abs(one['T_g']).max() < 150
        assert stated['noise'] == pytest.approx(np.std(one['T_g']) / 100, rel=0.02)


def test_nothing_in_the_bag_declares_an_effect(tmp_path, capsys):
    simulate(capsys, tmp_path / 'bag', '--effect', 'friction@motor:coulomb=10')
    for path in (tmp_path / 'bag').iterdir():
        content = path.read_bytes().lower()
        assert not any(word in content for word in (b'friction', b'coulomb', b'effect'))


def test_a_seed_makes_the_same_bag(tmp_path, capsys):
    for name, seed in (('one', '1'), ('same', '1'), ('other', '2')):
        (tmp_path / name).mkdir()
        simulate(capsys, tmp_path / name / 'bag.mcap', '--seed', seed, '--snr', '30')
    one, same, other = ((tmp_path / name / 'bag.mcap').read_bytes()
                        for name in ('one', 'same', 'other'))
    assert one == same
    assert one != other


@pytest.mark.parametrize('plant', PLANTS)
def test_every_plant(tmp_path, capsys, plant):
    duration = str(300 * PLANTS[plant].sample_time)
    status, truth, _ = simulate(capsys, tmp_path / 'bag', '--duration', duration, plant=plant)
    assert status == 0
    series = columns(tmp_path / 'bag', plant)
    assert sum(map(len, series)) == truth['samples']


def test_excitations_make_series(tmp_path, capsys):
    _, truth, _ = simulate(
        capsys, tmp_path / 'bag', '--excitation', 'u_m=chirp', '--excitation',
        'u_m=steps:amplitude=0.2', '--excitation', 'theta_d=sine:frequency=2,amplitude=0.01')
    assert [one['excitation'] for one in truth['series']] == [
        {'u_m': 'chirp', 'theta_d': 'sine'}, {'u_m': 'steps', 'theta_d': 'sine'}]
    for one in columns(tmp_path / 'bag'):
        np.testing.assert_allclose(
            one['theta_d'], 0.01 * np.sin(4 * np.pi * 0.002 * np.arange(300)), atol=1e-12)


def test_a_burst_is_added_for_as_long_as_it_lasts(tmp_path, capsys):
    burst = ('--burst', 'theta_d:begin=0.3,length=0.1,frequency=60,amplitude=0.002')
    simulate(capsys, tmp_path / 'without')
    simulate(capsys, tmp_path / 'with', *burst)
    for one, other in zip(columns(tmp_path / 'without'), columns(tmp_path / 'with'), strict=True):
        added = other['theta_d'] - one['theta_d']
        assert np.abs(np.delete(added, np.s_[150:200])).max() == 0
        assert 0.0015 < np.abs(added).max() <= 0.002
        assert np.abs(np.fft.rfft(added[150:200])).argmax() == 6        # times 10 Hz
        np.testing.assert_array_equal(one['u_m'], other['u_m'])
        assert np.abs(other['T_g'] - one['T_g'])[150:200].max() > 1.0


@pytest.mark.parametrize(('arguments', 'says'), [
    (['--burst', 'theta_d:begin=1'], 'it takes begin, length, frequency, amplitude'),
    (['--burst', 'theta_d:begin=1,length=0,frequency=60,amplitude=1'], 'above zero'),
    (['--burst', 'q:begin=1,length=1,frequency=60,amplitude=1'], "no input 'q'"),
    (['--effect', 'magic@motor:x=1'], 'takes no effect magic at port motor'),
    (['--effect', 'friction@spool:coulomb=1'], 'takes no effect friction at port spool'),
    (['--effect', 'friction@motor'], 'coulomb is missing'),
    (['--effect', 'friction@motor:coulomb=-1'], 'coulomb = -1 is outside'),
    (['--excitation', 'q=sine'], "no input 'q'; it has u_m, theta_d"),
    (['--excitation', 'u_m=sine', '--excitation', 'u_m=sine', '--excitation', 'theta_d=random',
      '--excitation', 'theta_d=random', '--excitation', 'theta_d=random'],
     '2 excitations for u_m but 3 series'),
    (['--set', 'J=-1'], 'J = -1 kg m^2 is outside its physical range'),
    (['--set', 'Q=1'], 'no parameter Q'),
    (['--constant', 'Q=1'], 'no constant Q'),
    (['--duration', '0'], 'at least ten samples'),
    (['--noise=-1'], 'not below zero'),
    (['--snr', 'nan'], '--snr nan: must be finite'),
    (['--snr', 'inf'], '--snr inf: must be finite'),
    (['--effect', 'stiffening@coupling:cubic=1e5', '--excitation', 'u_m=sine:amplitude=1e9'],
     'diverges'),
    (['--config', 'nowhere.yaml'], 'nowhere.yaml'),
])
def test_bad_input_ends_with_one_line_and_no_bag(tmp_path, capsys, arguments, says):
    status, result, err = simulate(capsys, tmp_path / 'bag', *arguments)
    assert status == 2
    assert result is None
    assert says in err
    assert err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_an_existing_output_is_left_alone(tmp_path, capsys):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'mine').write_text('precious')
    status, _, err = simulate(capsys, tmp_path / 'bag')
    assert status == 2
    assert 'exists already' in err
    assert (tmp_path / 'bag' / 'mine').read_text() == 'precious'


def test_for_a_person(tmp_path, capsys):
    assert main(['simulate', '--plant', 'cylinder', '-o', str(tmp_path / 'bag'), '--duration',
                 '0.2', '--effect', 'asymmetry@piston:imbalance=0.2']) == 0
    out = capsys.readouterr().out
    assert 'asymmetry at piston: imbalance 0.2' in out


def test_a_valve_stays_between_shut_and_open_by_default(tmp_path, capsys):
    for name in ('valve_servo', 'control_valve'):
        simulate(capsys, tmp_path / name, '--duration', '60' if name == 'control_valve' else '3',
                 plant=name)
        for one in columns(tmp_path / name, name):
            for signal in ('command', 'opening'):
                assert 0.0 <= one[signal].min() < one[signal].max() <= 1.0


def test_sensors_are_in_the_bag_with_noise_of_their_own(tmp_path, capsys):
    bag = tmp_path / 'bag'
    status, truth, _ = simulate(capsys, bag, '--snr', '40', '--sensor', 'p_L', '--sensor',
                                'omega_m:noise=0.01')
    assert status == 0
    data = read(bag, 'load_simulator')
    for one, stated in zip(data.recording.series, truth['series'], strict=True):
        assert one.columns.keys() == {'u_m', 'theta_d', 'T_g', 'p_L', 'omega_m'}
        assert stated['noises'].keys() == {'T_g', 'p_L', 'omega_m'}
        assert stated['noises']['omega_m'] == 0.01
        assert stated['noises']['p_L'] == pytest.approx(np.std(one['p_L']) / 100, rel=0.02)
        # The mean torque on the inertia is small: D_m p_L = T_g + B_m omega, on average.
        driven = 2e-5 * one['p_L'] - truth['parameters']['B_m']['value'] * one['omega_m']
        assert np.corrcoef(driven, one['T_g'])[0, 1] > 0.95
    plain = tmp_path / 'plain'
    simulate(capsys, plain, '--snr', '40')
    for one, other in zip(columns(bag), columns(plain), strict=True):
        assert one['u_m'].tolist() == other['u_m'].tolist()


def test_a_configuration_decides_which_sensors_there_are(tmp_path, capsys, caplog):
    bag, config = tmp_path / 'bag', tmp_path / 'rig.yaml'
    simulate(capsys, bag, '--sensor', 'p_L', '--sensor', 'x_v', '--sensor', 'theta_m')
    config.write_text('/**: {ros__parameters: {signals: {x_v: {scale: 1000.0}, '
                      'theta_m: {scale: 1e-300, offset: 1.0}}}}')
    series = read(bag, 'load_simulator', config=config).recording.series
    assert all(one.columns.keys() == {'u_m', 'theta_d', 'T_g', 'x_v'} for one in series)
    assert 'theta_m stands at 1 all the time' in caplog.text
    usual = read(bag, 'load_simulator').recording.series
    np.testing.assert_allclose(series[0]['x_v'], 1000.0 * usual[0]['x_v'])


@pytest.mark.parametrize(('sensor', 'says'), [
    ('p_X', "no sensor 'p_X'; it has p_L, x_v"), ('p_L:snr=3', 'takes noise=RMS'),
    ('p_L:noise=-1', 'not below zero')])
def test_a_wrong_sensor_is_refused(tmp_path, capsys, sensor, says):
    status, _, err = simulate(capsys, tmp_path / 'bag', '--sensor', sensor)
    assert status == 2
    assert says in err
    assert not (tmp_path / 'bag').exists()
