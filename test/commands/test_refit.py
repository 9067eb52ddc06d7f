from dataclasses import replace
import json
from pathlib import Path
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

from hydro_twin.commands.main import main
from hydro_twin.fitting.one_step import SearchResult
from hydro_twin.model import place, read_model, write_model
from hydro_twin.plants import PLANTS
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.rig import read, rig_of
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording
from hydro_twin.studies.b19.study import analytical_run, make_part
from hydro_twin.studies.l18.demonstration import simulated_steps
from hydro_twin.studies.l18.flow_characteristic import default_characteristic

BAGS = Path(__file__).parents[2] / 'bags'
TRUTH = {'J': 0.06, 'G': 9.5e3, 'K_p': 0.011, 'B_m': 45.0, 'K_ce': 4e-12}


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('refit') / 'bag'
    assert main(['simulate', '--plant', 'load_simulator', '-o', str(path), '--duration', '1.5',
                 '--snr', '45', '--excitation', 'u_m=multisine:highest=25', '--excitation',
                 'u_m=chirp', *(f'--set={name}={value}' for name, value in TRUTH.items())]) == 0
    return path


def refit(capsys, bag, out, *more, plant='load_simulator'):
    status = main(['refit', str(bag), '--plant', plant, '-o', str(out), '--json', *more])
    stdout, err = capsys.readouterr()
    return status, json.loads(stdout) if stdout else None, err


def test_a_model_is_fitted_anew_with_its_effects(bag, tmp_path, capsys):
    """From half of the friction that there is, and from parameters off by a quarter."""
    rubbing = tmp_path / 'rubbing'
    friction = 'friction@motor:coulomb=8'
    assert main(['simulate', '--plant', 'load_simulator', '-o', str(rubbing), '--duration', '3',
                 '--snr', '45', '--excitation', 'u_m=multisine:highest=25', '--effect', friction,
                 *(f'--set={name}={value}' for name, value in TRUTH.items())]) == 0
    capsys.readouterr()
    assert refit(capsys, bag, tmp_path / 'linear.yaml')[0] == 0
    linear = read_model(tmp_path / 'linear.yaml')
    off = replace(linear, values={**linear.values, 'G': 1.25 * linear.values['G']}, effects=(
        place('friction', 'motor', {'coulomb': 4.0}, linear.plant),))
    write_model(off, tmp_path / 'off.yaml')
    status, result, _ = refit(capsys, rubbing, tmp_path / 'anew.yaml', '--model',
                              str(tmp_path / 'off.yaml'))
    assert status == 0
    (effect,) = result['effects']
    found = effect['parameters']['coulomb']
    assert abs(found['value'] - 8.0) < 4.0 * found['std_error'] < 1.0
    stiffness = result['parameters']['G']
    assert abs(stiffness['value'] - TRUTH['G']) < 4.0 * stiffness['std_error']
    again = read_model(tmp_path / 'anew.yaml')
    assert again.effects[0].named['coulomb'] == found['value']
    assert again.noise is not None
    assert result['test']['free_run'] < 1.1 * again.noise.measurement


def test_finds_what_the_simulation_was_given(bag, tmp_path, capsys):
    out = tmp_path / 'model.yaml'
    status, result, _ = refit(capsys, bag, out)
    assert status == 0
    for name, value in TRUTH.items():
        found = result['parameters'][name]
        assert found['identifiable']
        # theta_d is known only at the samples, which costs a little on top of the noise.
        assert abs(found['value'] - value) < 4 * found['std_error'] + 0.01 * value
        assert found['std_error'] < 0.1 * value
    values = {name: p['value'] for name, p in result['parameters'].items()}
    # Of the paper's nine only these products can be known, not their factors.
    true = {p.name: (p.lower * p.upper) ** 0.5 for p in PLANTS['load_simulator'].parameters}
    assert values['K_q'] * values['K_sv'] == pytest.approx(true['K_q'] * true['K_sv'], rel=0.01)
    assert values['V_m'] / values['beta_e'] == pytest.approx(
        true['V_m'] / true['beta_e'], rel=0.01)
    for name in ('K_q', 'K_sv', 'V_m', 'beta_e'):
        assert result['parameters'][name]['std_error'] is None
        assert not result['parameters'][name]['identifiable']
    assert set(result['combinations']) == {'V_m/beta_e', 'K_q*K_sv'}
    for part in ('train', 'test'):
        assert set(result[part]) == {'one_step', 'free_run', 'observer'}
        assert result[part]['observer'] < min(result[part]['one_step'],
                                              1.02 * result[part]['free_run'])
        assert result[part]['free_run'] < 0.5
        assert result['unconstrained'][part] <= result[part]['one_step']
        assert result[part]['one_step'] < result['persistence'][part]


def test_the_model_file_knows_where_it_came_from(bag, tmp_path, capsys):
    out = tmp_path / 'model.yaml'
    _, result, _ = refit(capsys, bag, out, '--criterion', 'one_step', '--seed', '3')
    model = read_model(out)
    assert {name: p.value for name, p in model.parameters.items()} == {
        name: p['value'] for name, p in result['parameters'].items()}
    assert model.errors['after']['free_run'] == {
        part: result[part]['free_run'] for part in ('train', 'test')}
    assert model.record.reference_rms('one_step') == result['test']['one_step']
    assert model.record.provenance['bags'] == [{'path': str(bag), 'sha256': source_of(bag).sha256}]
    assert model.record.provenance['seed'] == 3
    assert model.record.provenance['method'] == 'least_squares'
    assert model.record.provenance['criterion'] == 'one_step'
    assert {'command', 'version'} <= set(model.record.provenance)
    assert shlex.split(model.record.provenance['command']) == [
        'hydro-twin', 'refit', str(bag), '--plant', 'load_simulator', '-o', str(out), '--json',
        '--criterion', 'one_step', '--seed', '3']


def test_as_a_program_of_ros_the_model_file_names_the_verb(bag, tmp_path):
    arguments = [str(bag), '--plant', 'load_simulator', '-o', str(tmp_path / 'model.yaml')]
    subprocess.run([sys.executable, str(BAGS.parent / 'scripts' / 'refit'), *arguments,
                    '--criterion', 'one_step'], check=True, capture_output=True)
    command = read_model(tmp_path / 'model.yaml').record.provenance['command']
    assert shlex.split(command)[:6] == ['hydro-twin', 'refit', *arguments[:4]]


def test_replay_model_file_and_study_agree_with_refit(bag, tmp_path, capsys):
    out = tmp_path / 'model.yaml'
    _, result, _ = refit(capsys, bag, out, '--test', str(bag))
    assert result['train'] == result['test']
    main(['replay', str(bag), '--model', str(out), '--json'])
    replayed = json.loads(capsys.readouterr().out)
    model, rig = read_model(out), rig_of(PLANTS['load_simulator'])
    part = {'train': make_part('training', read([bag], rig), rig.plant)}
    values = np.array([model.parameters[p.name].value for p in rig.plant.parameters])
    run = analytical_run(SearchResult(values, 0.0, np.zeros(1)), part, replace(model, effects=()))
    for mode in ('one_step', 'free_run'):
        assert replayed[mode]['rmse'] == pytest.approx(result['test'][mode], rel=1e-12)
        assert model.record.reference_rms(mode) == pytest.approx(result['test'][mode], rel=1e-12)
        assert run.errors['train', mode] == pytest.approx(result['test'][mode], rel=1e-9)
    assert replayed['persistence']['rmse'] == pytest.approx(result['persistence']['test'])


def test_train_and_test_make_up_the_whole_bag(bag, tmp_path, capsys):
    """Of 750 samples of a series 250 test, the first 50 of which are not scored."""
    out = tmp_path / 'model.yaml'
    _, result, _ = refit(capsys, bag, out)
    main(['replay', str(bag), '--model', str(out), '--json'])
    replayed = json.loads(capsys.readouterr().out)
    pooled = np.sqrt((200 * result['test']['free_run'] ** 2
                      + 500 * result['train']['free_run'] ** 2) / 700)
    assert replayed['free_run']['rmse'] == pytest.approx(pooled, rel=1e-9)


@pytest.fixture
def fast_cylinder(tmp_path, capsys):
    """Record a cylinder five times as fast as the search box has it."""
    main(['simulate', '--plant', 'cylinder', '-o', str(tmp_path / 'fast'), '--duration', '3',
          '--set', 'K_v=50', '--snr', '80'])
    capsys.readouterr()
    assert next(p.upper for p in PLANTS['cylinder'].parameters if p.name == 'K_v') == 10.0
    return tmp_path / 'fast'


def test_a_parameter_beyond_the_search_box_is_found_there(fast_cylinder, tmp_path, capsys):
    _, result, _ = refit(capsys, fast_cylinder, tmp_path / 'model.yaml', plant='cylinder')
    assert result['parameters']['K_v']['value'] == pytest.approx(50.0, rel=0.01)
    assert (result['at_bound'], result['parameters']['K_v']['at_bound']) == ([], None)


def test_a_parameter_at_a_bound_of_its_search_is_said_to_be(fast_cylinder, tmp_path, capsys):
    """The search of the one-step error stays in the box."""
    out, one_step = tmp_path / 'model.yaml', ('--criterion', 'one_step')
    main(['refit', str(fast_cylinder), '--plant', 'cylinder', '-o', str(out), *one_step])
    assert 'K_v ended at the upper bound' in ' '.join(capsys.readouterr().out.split())
    _, result, _ = refit(capsys, fast_cylinder, out, *one_step, plant='cylinder')
    assert result['parameters']['K_v']['at_bound'] == 'upper'
    assert 'K_v' in result['at_bound']
    model = read_model(out)
    assert model.parameters['K_v'].at_bound == 'upper'
    assert any(note.startswith('K_v ended') for note in model.record.notes)


def test_a_one_step_fit_of_noisy_outputs_has_no_standard_errors(tmp_path, capsys):
    bag, out = tmp_path / 'bag', tmp_path / 'model.yaml'
    main(['simulate', '--plant', 'valve_servo', '-o', str(bag), '--duration', '1.5',
          '--set', 'tau=0.00293', '--snr', '50'])
    capsys.readouterr()
    _, result, _ = refit(capsys, bag, out, '--criterion', 'one_step', plant='valve_servo')
    assert abs(result['parameters']['tau']['value'] - 0.00293) > 0.3 * 0.00293      # biased
    assert all(p['std_error'] is None for p in result['parameters'].values())
    assert any('biases' in note for note in result['notes'])
    assert result['notes'] == list(read_model(out).record.notes)
    _, result, _ = refit(capsys, bag, out, plant='valve_servo')
    tau = result['parameters']['tau']
    assert abs(tau['value'] - 0.00293) < 4 * tau['std_error']


@pytest.mark.parametrize('method', ['random', 'pso'])
def test_population_methods_of_the_paper(bag, tmp_path, capsys, method):
    status, result, _ = refit(capsys, bag, tmp_path / 'model.yaml', '--method', method)
    assert status == 0
    direct = refit(capsys, bag, tmp_path / 'model.yaml', '--criterion', 'one_step')[1]
    # No search beats least squares on the error that both minimise.
    assert direct['train']['one_step'] <= result['train']['one_step'] * (1 + 1e-9)
    assert result['train']['one_step'] < result['persistence']['train']
    for p in PLANTS['load_simulator'].parameters:
        assert p.lower <= result['parameters'][p.name]['value'] <= p.upper


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['mlp', 'hybrid'])
def test_networks(bag, tmp_path, capsys, kind):
    pytest.importorskip('torch')
    out = tmp_path / 'model.yaml'
    status, result, _ = refit(capsys, bag, out, '--predictor', kind)
    assert status == 0
    assert (tmp_path / 'model.safetensors').is_file()
    assert result['train']['one_step'] < result['persistence']['train']
    assert bool(result['parameters']) == (kind == 'hybrid')
    assert main(['replay', str(bag), '--model', str(out), '--json']) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed['one_step']['rmse'] == pytest.approx(
        np.hypot(*(np.sqrt(share) * result[part]['one_step']
                   for part, share in (('train', 2 / 3), ('test', 1 / 3)))), rel=0.05)


def test_valve_servo_by_its_published_method(tmp_path, capsys):
    bag = tmp_path / 'bag'
    assert main(['simulate', '--plant', 'valve_servo', '-o', str(bag), '--duration', '12',
                 '--set', 'T_y=0.0203', '--set', 'T_c=0.294', '--set', 'tau=0.00293', '--set',
                 'k_1=1.093', '--excitation', 'command=steps:amplitude=0.4']) == 0
    capsys.readouterr()
    status, result, _ = refit(capsys, bag, tmp_path / 'model.yaml', '--method', 'network',
                              plant='valve_servo')
    assert status == 0
    assert result['parameters']['k_1']['value'] == 1.093
    assert result['parameters']['k_1']['held']
    assert result['parameters']['T_c']['value'] == pytest.approx(0.294, rel=0.01)


@pytest.mark.parametrize(('bag', 'T_c'), [
    ('valve_steps', 0.01), pytest.param('valve_limit', 0.2, marks=pytest.mark.slow)])
def test_the_published_method_takes_the_sample_bags(bag, T_c, tmp_path, capsys):
    """Whose noise makes its poles those of no servo; at its limit the valve is not linear."""
    status, result, _ = refit(capsys, BAGS / bag, tmp_path / 'model.yaml', '--method', 'network',
                              plant='valve_servo')
    assert status == 0
    assert result['parameters']['T_c']['value'] == pytest.approx(0.294, rel=T_c)


@pytest.fixture(scope='module')
def short_steps(tmp_path_factory):
    """Write four seconds of the servo, one at the end of its travel."""
    folder = tmp_path_factory.mktemp('servo')
    series = simulated_steps((0.5, 0.9, 1.1, 0.4), default_characteristic())
    write_recording(folder / 'bag', [series], load_signals('valve_servo', ('command', 'opening')))
    return folder / 'bag'


def test_a_known_parameter_is_held_and_the_others_are_reported(short_steps, tmp_path, capsys):
    """With k_1 known T_c is too, and with d_1 of the curve the limit does not bend it."""
    path = tmp_path / 'model.yaml'
    status, result, _ = refit(capsys, short_steps, path, '--fix', 'k_1=1.093', '--curve',
                              str(BAGS.parent / 'config' / 'flow_characteristic.csv'),
                              plant='valve_servo')
    assert status == 0
    found = result['parameters']
    assert found['k_1'] == {'value': 1.093, 'unit': '1', 'std_error': None,
                            'identifiable': False, 'held': True, 'at_bound': None}
    assert found['T_c']['value'] == pytest.approx(0.294, rel=1e-3)
    assert found['T_c']['identifiable']
    assert found['T_c']['std_error'] is not None
    text = path.read_text()
    assert re.search(r"k_1:\n    value: 1.093\n    unit: '1'\n    std_error: held", text)
    model = read_model(path)
    assert model.parameters['k_1'].held
    assert model.effects[0].named == {'lower': 0.0, 'upper': pytest.approx(1.05),
                                      'softness': 0.0}


@pytest.mark.parametrize('arguments', [
    ['--criterion', 'one_step'], ['--method', 'random']])
def test_every_method_holds(short_steps, tmp_path, capsys, arguments):
    status, result, _ = refit(capsys, short_steps, tmp_path / 'model.yaml', '--fix', 'T_c=0.4',
                              *arguments, plant='valve_servo')
    assert status == 0
    assert list(result['parameters']) == ['T_y', 'T_c', 'tau', 'k_1']
    assert result['parameters']['T_c']['value'] == 0.4
    assert 'T_c/k_1' not in result['combinations']


@pytest.mark.parametrize(('arguments', 'says'), [
    (['--method', 'pso', '--criterion', 'free_run'], 'only least_squares knows'),
    (['--method', 'network', '--criterion', 'one_step'], 'for the valve_servo'),
    (['--fix', 'k_1=1'], 'no parameter k_1'),
    (['--fix', 'J'], 'should read like'),
    (['--curve', str(BAGS.parent / 'config' / 'flow_characteristic.csv')],
     'is for the valve_servo, not for load_simulator'),
    (['--method', 'guess'], "no method 'guess'; there are least_squares, bees, "),
    (['--constant', 'D_m=0'], 'must be a positive number'),
    (['--test', 'nowhere'], 'nowhere: no such bag'),
])
def test_bad_input_ends_with_one_line_and_no_model(bag, tmp_path, capsys, arguments, says):
    try:
        status, _, err = refit(capsys, bag, tmp_path / 'model.yaml', *arguments)
    except SystemExit as end:
        status, err = end.code, capsys.readouterr().err
    assert status == 2
    assert says in err
    assert err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_a_bag_that_is_too_short_or_still(tmp_path, capsys):
    short = tmp_path / 'short'
    main(['simulate', '--plant', 'load_simulator', '-o', str(short), '--duration', '0.1'])
    still = tmp_path / 'still'
    main(['simulate', '--plant', 'load_simulator', '-o', str(still), '--duration', '1',
          '--excitation', 'u_m=sine:amplitude=0', '--excitation', 'theta_d=sine:amplitude=0'])
    capsys.readouterr()
    status, _, err = refit(capsys, short, tmp_path / 'model.yaml')
    assert status == 2
    assert 'long enough' in err
    status, _, err = refit(capsys, still, tmp_path / 'model.yaml')
    assert status == 2
    assert 'the training part: T_g is constant at 0' in err
    assert not (tmp_path / 'model.yaml').exists()


def test_what_is_only_predicted_may_be_at_rest_or_short(bag, tmp_path, capsys):
    still = tmp_path / 'still'
    main(['simulate', '--plant', 'load_simulator', '-o', str(still), '--duration', '0.04',
          '--excitation', 'u_m=sine:amplitude=0', '--excitation', 'theta_d=sine:amplitude=0'])
    capsys.readouterr()
    status, result, _ = refit(capsys, bag, tmp_path / 'model.yaml', '--test', str(still),
                              '--criterion', 'one_step')
    assert status == 0
    assert result['test']['one_step'] == pytest.approx(0.0, abs=1e-9)
    assert result['unconstrained']['test'] == pytest.approx(0.0, abs=1e-9)
    assert result['persistence']['test'] == 0.0


@pytest.mark.parametrize(('name', 'says'), [
    ('', 'is a folder; a file is needed'), ('w.safetensors', 'name it')])
def test_where_no_model_can_be_is_said_before_the_fit(tmp_path, capsys, name, says):
    status, _, err = refit(capsys, 'no bag', tmp_path / name)
    assert status == 2
    assert says in err
    assert err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there(bag, tmp_path, capsys):
    status, _, err = refit(capsys, bag, tmp_path / 'nowhere' / 'model.yaml')
    assert status == 2
    assert 'no folder' in err


def test_for_a_person(bag, tmp_path, capsys):
    assert main(['refit', str(bag), '--plant', 'load_simulator', '-o',
                 str(tmp_path / 'model.yaml'), '--criterion', 'one_step']) == 0
    out = capsys.readouterr().out
    assert 'not identifiable' in out
    assert 'last sample' in out
