"""A rig with three sensors of which one fails half-way: from its bag to the figures."""
from dataclasses import replace
import json

import numpy as np
import pytest

from hydro_twin.api import read
from hydro_twin.commands.main import main
from hydro_twin.model import read_model
from hydro_twin.plants import PLANTS
from hydro_twin.recording.rig import rig_of
from hydro_twin.recording.write import write_recording

PLANT = PLANTS['load_simulator']
TRUTH = {'K_q': 1.1, 'J': 0.05}
NOISE = {'p_L': 3e4, 'x_v': 1.5e-7, 'omega_m': 5e-3}


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Record a rig; its pressure fails half-way through each series."""
    folder = tmp_path_factory.mktemp('sensors')
    assert main(['simulate', '--plant', PLANT.name, '-o', str(folder / 'whole'), '--duration',
                 '1.2', '--noise', '0.5',
                 *(f'--set={name}={value}' for name, value in TRUTH.items()),
                 *(f'--sensor={name}:noise={rms}' for name, rms in NOISE.items())]) == 0
    rig = rig_of(PLANT)
    series = read(folder / 'whole', PLANT).recording.series
    failing = [replace(one, columns={**one.columns, 'p_L': np.where(
        np.arange(len(one)) < len(one) // 2, one['p_L'], np.nan)}) for one in series]
    write_recording(folder / 'bag', failing, rig.signals | {
        name: rig.sensors[name] for name in NOISE})
    return folder / 'bag'


def run(capsys, *arguments):
    status = main([*map(str, arguments), '--json'])
    out, _ = capsys.readouterr()
    assert status == 0
    return json.loads(out)


def test_a_sensor_that_fails_half_way_is_used_while_it_works(bag, tmp_path, capsys):
    series = read(bag, PLANT).recording.series
    assert [len(one) for one in series] == [600, 600, 600]
    assert all(np.isfinite(one['p_L'][:300]).all() and np.isnan(one['p_L'][301:]).all()
               for one in series)

    fitted = run(capsys, 'refit', bag, '--plant', PLANT.name, '-o', tmp_path / 'model.yaml')
    assert list(fitted['combinations']) == ['V_m/beta_e']
    for name, value in TRUTH.items():
        found = fitted['parameters'][name]
        assert abs(found['value'] - value) < 4.0 * found['std_error']
    assert list(fitted['outputs']) == ['T_g', *NOISE]
    for name, rms in {'T_g': 0.5, **NOISE}.items():
        assert fitted['outputs'][name]['noise'] == pytest.approx(rms, rel=0.12)
        assert fitted['outputs'][name]['train'] == pytest.approx(rms, rel=0.3)
    assert fitted['outputs']['T_g']['test'] == fitted['test']['free_run']

    replayed = run(capsys, 'replay', bag, '--model', tmp_path / 'model.yaml')
    assert list(replayed['outputs']) == ['T_g', *NOISE]
    assert replayed['outputs']['T_g']['free_run'] == replayed['free_run']
    start_up = PLANT.start_samples(0.002)
    assert replayed['outputs']['x_v']['samples'] == 3 * (600 - start_up)
    assert replayed['outputs']['p_L']['samples'] == pytest.approx(3 * (300 - start_up), abs=3)
    for name, rms in NOISE.items():
        assert replayed['outputs'][name]['free_run']['rmse'] == pytest.approx(rms, rel=0.3)


def test_the_observer_takes_in_the_sensors_and_knows_the_states_better(bag, tmp_path, capsys):
    config = tmp_path / 'rig.yaml'
    config.write_text('/**: {ros__parameters: {constants: {D_m: 2.0e-5}}}')
    run(capsys, 'refit', bag, '--plant', PLANT.name, '-o', tmp_path / 'model.yaml')
    noise = read_model(tmp_path / 'model.yaml').noise
    assert noise.measurement == pytest.approx(0.5, rel=0.1)
    assert {name: noise.sensors[name] == pytest.approx(rms, rel=0.15)
            for name, rms in NOISE.items()} == dict.fromkeys(NOISE, True)
    with_all, with_none = (
        run(capsys, 'replay', bag, '--model', tmp_path / 'model.yaml', *more)['states']
        for more in ((), ('--config', config)))
    # Nothing disturbs this rig, so that the model alone knows the states nearly as well.
    assert all(with_all[name]['std'] < with_none[name]['std'] for name in PLANT.states)


def test_a_configuration_without_sensors_fits_the_output_alone(bag, tmp_path, capsys):
    config = tmp_path / 'rig.yaml'
    config.write_text('/**: {ros__parameters: {constants: {D_m: 2.0e-5}}}')
    fitted = run(capsys, 'refit', bag, '--plant', PLANT.name, '--config', config, '-o',
                 tmp_path / 'model.yaml')
    assert list(fitted['combinations']) == ['V_m/beta_e', 'K_q*K_sv']
    assert list(fitted['outputs']) == ['T_g']
    assert read_model(tmp_path / 'model.yaml').noise.sensors == {}
