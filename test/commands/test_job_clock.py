"""Every verb on one recording at several sample times: the physics found is the same."""
import csv
from dataclasses import replace
import json

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from hydro_twin.commands.main import main
from hydro_twin.live.inputs import TwinInputs
from hydro_twin.live.twin import Twin
from hydro_twin.live.writer import Writer
from hydro_twin.model import Model, place, read_model, write_model
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.network import Network, network_bytes
from hydro_twin.recording.series import Recording, Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording
from hydro_twin.share import share_folder
from hydro_twin.simulation.simulate import simulate

CYLINDER = PLANTS['cylinder']
TRUTH = {'tau': 0.06, 'K_v': 0.2}
NOISE = 2e-4        # m
REST = 20           # ms for which a command rests: every sample time here divides it


def commands(count, rest, rng):
    """Draw commands that each rest for some samples, the first of them nought."""
    levels = rng.uniform(-0.5, 0.5, count // rest + 1)
    levels[0] = 0.0
    return np.repeat(levels, rest)[:count]


def recorded(plant, truth, sample_time, count, rest, noise):
    """Make a series of a linear plant, by scipy, under such commands; noise on the output."""
    rng = np.random.default_rng(0)
    laws, command = plant.laws(truth), commands(count, rest, rng)
    discrete = cont2discrete((laws.A, laws.B, laws.C, laws.D), sample_time, 'zoh')
    output = dlsim(discrete, command)[1][:, 0] + noise * rng.standard_normal(count)
    return Series({'command': command, plant.output.name: output}, sample_time, 10**9)


def every(series, n):
    return Series({name: column[::n] for name, column in series.columns.items()},
                  n * series.sample_time, series.start)


def write(path, plant, series):
    write_recording(path, [series], load_signals(plant.name, [s.name for s in plant.signals]))
    return path


def smooth():
    """Make 4 s of a cylinder at 1 ms under a smooth command, without noise."""
    return simulate(replace(CYLINDER, sample_time=0.001), TRUTH, [], {'command': lambda t: (
        0.3 * np.sin(2 * np.pi * 0.5 * t) + 0.2 * np.sin(2 * np.pi * 1.3 * t))}, 4.0, 10**9)


@pytest.fixture(scope='module')
def fast():
    """One recording of a cylinder, every millisecond."""
    return recorded(CYLINDER, TRUTH, 0.001, 4000, REST, NOISE)


@pytest.fixture(scope='module')
def bags(tmp_path_factory, fast):
    """Write it at 1, 4 and 10 ms, by milliseconds."""
    folder = tmp_path_factory.mktemp('clock')
    return {n: write(folder / f'bag_{n}', CYLINDER, every(fast, n)) for n in (1, 4, 10)}


@pytest.fixture
def config(tmp_path):
    """Write a parameter file with a sample time."""
    def at(sample_time):
        path = tmp_path / f'at_{sample_time}.yaml'
        path.write_text(f'/**:\n  ros__parameters:\n    sample_time: {sample_time}\n')
        return path
    return at


@pytest.fixture
def model(tmp_path):
    """Write the true model, at 2 ms."""
    path = tmp_path / 'true.yaml'
    write_model(Model(CYLINDER, TRUTH, 0.002), path)
    return path


def verb(capsys, *arguments):
    status = main([*map(str, arguments), '--json'])
    out, err = capsys.readouterr()
    return status, json.loads(out) if out else None, err


def refit(capsys, bag, out, *more, plant='cylinder'):
    status, result, err = verb(capsys, 'refit', bag, '--plant', plant, '-o', out, *more)
    assert status == 0, err
    assert read_model(out).sample_time == result['sample_time']
    return result


def assert_true(result, truth):
    for name, value in truth.items():
        found = result['parameters'][name]
        assert abs(found['value'] - value) < 4 * found['std_error']
        assert found['std_error'] < 0.05 * value


@pytest.mark.parametrize('sample_time', [0.001, 0.002, 0.004, 0.01])
def test_refit_at_the_sample_time_of_the_configuration(bags, config, tmp_path, capsys,
                                                       sample_time):
    result = refit(capsys, bags[1], tmp_path / 'model.yaml', '--config', config(sample_time))
    assert result['sample_time'] == sample_time
    assert_true(result, TRUTH)
    assert result['test']['free_run'] < 2 * NOISE


@pytest.mark.parametrize(('every_ms', 'sample_time'), [(1, 0.002), (4, 0.004), (10, 0.01)])
def test_refit_at_what_the_recording_bears(bags, tmp_path, capsys, every_ms, sample_time):
    result = refit(capsys, bags[every_ms], tmp_path / 'model.yaml')
    assert result['sample_time'] == sample_time
    assert_true(result, TRUTH)


@pytest.mark.parametrize('sample_time', [0.001, 0.002, 0.004, 0.01])
def test_refit_to_one_step(config, tmp_path, capsys, sample_time):
    """Commands are smooth, since eq. 1 takes them as straight lines between samples."""
    bag = write(tmp_path / 'bag', CYLINDER, smooth())
    result = refit(capsys, bag, tmp_path / 'model.yaml', '--criterion', 'one_step', '--config',
                   config(sample_time))
    assert result['sample_time'] == sample_time
    for name, value in TRUTH.items():
        assert result['parameters'][name]['value'] == pytest.approx(value, rel=0.02)


def test_refit_of_the_sample_bag_of_the_valve(config, tmp_path, capsys):
    bag = share_folder() / 'bags' / 'valve_steps'
    result = refit(capsys, bag, tmp_path / 'model.yaml', '--config', config(0.004),
                   plant='valve_servo')
    values = {name: p['value'] for name, p in result['parameters'].items()}
    error = result['combinations']['T_c/k_1']
    assert values['T_c'] / values['k_1'] == pytest.approx(0.269, rel=4 * error)
    assert error < 1e-3


@pytest.mark.parametrize(('plant', 'truth', 'sample_time', 'rest', 'noise'), [
    ('cylinder', {'tau': 0.3, 'K_v': 0.2}, 0.05, 4, 1e-3),
    ('control_valve', {'tau': 2.0, 'K': 0.95}, 0.08, 50, 5e-3)])
def test_refit_of_slow_recordings(tmp_path, capsys, plant, truth, sample_time, rest, noise):
    bag = write(tmp_path / 'bag', PLANTS[plant],
                recorded(PLANTS[plant], truth, sample_time, 1000, rest, noise))
    result = refit(capsys, bag, tmp_path / 'model.yaml', plant=plant)
    assert result['sample_time'] == sample_time
    assert_true(result, truth)


def test_bags_of_several_rates_share_the_clock_of_the_slowest(bags, tmp_path, capsys, caplog):
    result = refit(capsys, bags[1], tmp_path / 'model.yaml', '--test', bags[10])
    assert result['sample_time'] == 0.01
    assert_true(result, TRUTH)
    (said,) = (record.getMessage() for record in caplog.records)
    assert said == f'all bags are read at 0.01 s, the sample time of the slowest, {bags[10]}'


@pytest.mark.parametrize('kind', ['mlp', 'hybrid'])
def test_a_network_runs_at_its_own_clock_only(bags, model, tmp_path, capsys, kind):
    path = tmp_path / 'network.yaml'
    network = Network(np.array([5, 1]), np.zeros(6), np.zeros(5), np.ones(5), 1.0, 1e3)
    (tmp_path / 'network.safetensors').write_bytes(network_bytes(network))
    write_model(replace(read_model(model), sample_time=0.004, kind=kind,
                        network='network.safetensors'), path)
    status, result, _ = verb(capsys, 'replay', bags[1], '--model', path)
    assert (status, result['sample_time']) == (0, 0.004)
    status, _, err = verb(capsys, 'replay', bags[10], '--model', path)
    assert status == 2
    assert f'{path}: a model of kind {kind} runs at 0.004 s only, not at 0.01 s' in err
    assert err.count('\n') == 1


@pytest.mark.slow
def test_networks_are_trained_at_the_clock_of_the_recording(bags, model, tmp_path, capsys):
    pytest.importorskip('torch')
    small = ('--hidden', '2', '--epochs', '50')
    refit(capsys, bags[4], tmp_path / 'mlp.yaml', '--predictor', 'mlp', *small)
    hybrid = refit(capsys, bags[4], tmp_path / 'hybrid.yaml', '--predictor', 'hybrid', '--model',
                   model, *small)
    assert hybrid['sample_time'] == read_model(tmp_path / 'mlp.yaml').sample_time == 0.004
    # Run at 4 ms as it was at 2 ms, the physics would move at half the speed.
    assert hybrid['test']['one_step'] < 3 * NOISE


@pytest.mark.parametrize(('every_ms', 'given', 'sample_time'), [
    (1, None, 0.002), (4, None, 0.004), (10, None, 0.01), (1, 0.001, 0.001), (1, 0.01, 0.01)])
def test_replay_scores_what_was_measured(bags, model, config, capsys, every_ms, given,
                                         sample_time):
    more = ('--config', config(given)) if given else ()
    status, result, err = verb(capsys, 'replay', bags[every_ms], '--model', model, *more)
    assert status == 0, err
    assert result['sample_time'] == sample_time
    assert result['samples'] == pytest.approx(4.0 / sample_time, abs=2)
    assert result['free_run']['rmse'] == pytest.approx(NOISE, rel=0.2)


def test_an_effect_runs_at_another_clock(tmp_path, capsys):
    """A model with a dead zone, at 1 ms, replays a recording at 10 ms."""
    limit = place('dead_zone', 'command', {'width': 0.1}, CYLINDER)
    levels = commands(2000, 1, np.random.default_rng(0))
    one = simulate(replace(CYLINDER, sample_time=0.001), TRUTH, [limit],
                   {'command': lambda t: levels[(t / 0.02 + 1e-6).astype(int)]}, 2.0, 10**9)
    bag = write(tmp_path / 'bag', CYLINDER, every(one, 10))
    path = tmp_path / 'model.yaml'
    errors = []
    for effects in ((limit,), ()):
        write_model(Model(CYLINDER, TRUTH, 0.001, effects), path)
        errors.append(verb(capsys, 'replay', bag, '--model', path)[1]['free_run']['rmse'])
    assert errors[0] < 0.01 * errors[1]


def test_simulate_at_the_sample_time_of_the_configuration(config, tmp_path, capsys):
    status, truth, _ = verb(
        capsys, 'simulate', '--plant', 'cylinder', '-o', tmp_path / 'bag', '--config',
        config(0.01), '--duration', '6', '--excitation', 'command=steps:amplitude=0.5',
        *(f'--set={name}={value}' for name, value in TRUTH.items()), '--noise', NOISE)
    assert (status, truth['sample_time'], truth['samples']) == (0, 0.01, 600)
    result = refit(capsys, tmp_path / 'bag', tmp_path / 'model.yaml')
    assert result['sample_time'] == 0.01
    assert_true(result, TRUTH)


def test_a_table_at_its_own_rate(fast, tmp_path, capsys):
    table = tmp_path / 'table.csv'
    with table.open('w', newline='') as file:
        rows = csv.writer(file)
        rows.writerow(['t', 'command', 'x'])
        slow = every(fast, 4)
        rows.writerows(zip(0.004 * np.arange(len(slow)), slow['command'], slow['x'], strict=True))
    (tmp_path / 'map.yaml').write_text(
        'plant: cylinder\ntime: t\nsignals: {command: command, x: x}\n')
    status, result, _ = verb(capsys, 'import', table, '-o', tmp_path / 'bag', '--map',
                             tmp_path / 'map.yaml')
    assert (status, result['rate']) == (0, pytest.approx(250.0))
    result = refit(capsys, tmp_path / 'bag', tmp_path / 'model.yaml')
    assert result['sample_time'] == 0.004
    assert_true(result, TRUTH)


def test_a_study_runs_at_the_clock_of_its_recordings(monkeypatch):
    """Its networks are left out: their models are looked at only."""
    from hydro_twin.studies.b19 import study

    models = []
    monkeypatch.setattr(study, 'TITLES', {'least_squares': 'LS', 'mlp': 'MLP', 'hybrid': 'hybrid'})
    monkeypatch.setattr(study, 'network_runs', lambda model, *_: models.append(model) or ())
    one = every(smooth(), 10)
    halves = [Recording((one.part(*ends),)) for ends in ((0, 200), (200, 400))]
    found = study.study(*halves, CYLINDER, {}, 1)
    assert [model.sample_time for model in models] == [0.01, 0.01]
    for name, value in TRUTH.items():
        assert models[1].parameters[name].value == pytest.approx(value, rel=0.02)
    (run,) = found.runs['least_squares']
    assert run.errors['train', 'free_run'] < 0.02 * np.std(one['x'])


@pytest.mark.slow
@pytest.mark.parametrize(('every_ms', 'given', 'sample_time', 'fresh'), [
    (1, 0.001, 0.001, True), (1, None, 0.002, True), (1, 0.004, 0.004, True),
    (10, None, 0.01, True), (10, None, 0.01, False)])
def test_trace(bags, model, config, tmp_path, capsys, every_ms, given, sample_time, fresh):
    more = (*(('--config', config(given)) if given else ()),
            *(() if fresh else ('--model', model)))
    out = tmp_path / 'out'
    status, report, err = verb(capsys, 'trace', bags[every_ms], '--plant', 'cylinder', '-o', out,
                               *more)
    assert status == 0, err
    assert report['verdict'] == 'nothing_missing'
    assert report['after']['free_run']['test'] == pytest.approx(NOISE, rel=0.3)
    # What a finer grid made up between the samples would pass for less noise than there is.
    assert report['noise_floor'] == pytest.approx(NOISE, rel=0.3)
    assert report['remainder']['lines_hz'] == []
    after = read_model(out / 'model.yaml')
    assert after.sample_time == sample_time
    for name, value in TRUTH.items():
        found = after.parameters[name]
        assert abs(found.value - value) < (4 * found.std_error if fresh else 0.05 * value)


@pytest.mark.parametrize('sample_time', [0.001, 0.002, 0.004, 0.01])
def test_the_live_twin_runs_at_the_clock_of_its_model(fast, model, sample_time):
    """It takes messages every 1 ms, whatever the clock is."""
    signals = load_signals('cylinder', ['command', 'x'])
    predictor = read_model(model).at(sample_time).predictor()
    live, twin = TwinInputs(CYLINDER, signals, sample_time, 0.1), Twin('', predictor, 'free_run')
    message, seen, predicted = Writer(['rod'], 'm'), [], []
    for k, values in enumerate(zip(fast['command'], fast['x'], strict=True)):
        stamp = fast.start + 1_000_000 * k
        for feed, value in zip(live.feeds, values, strict=True):
            live.take(feed, message.write(stamp, value), lambda: 0)
        while live.aligner.advance():
            predicted.append(twin.step(live.aligner.stamp, live.aligner.inputs,
                                       live.aligner.measured))
            seen.append(live.aligner.measured)
    one = every(fast, round(1e3 * sample_time))
    assert (seen, predicted) == (one['x'].tolist(), predictor.free_run(one).tolist())
    error = np.subtract(seen, predicted)[CYLINDER.start_samples(sample_time):]
    assert np.sqrt(np.mean(error ** 2)) == pytest.approx(NOISE, rel=0.2)
