from dataclasses import replace
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from hydro_twin.commands.main import main
from hydro_twin.model import load_predictor, Model, place, write_model
from hydro_twin.plants import PLANTS
from hydro_twin.report import picture

PLANT = PLANTS['load_simulator']
MODEL = Model(PLANT, PLANT.constant_values() | {
    name: 1.02 * value for name, value in PLANT.middle().items()}, 0.002)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('replay') / 'bag'
    assert main(['simulate', '--plant', 'load_simulator', '-o', str(path), '--duration', '0.8',
                 '--snr', '35']) == 0
    return path


@pytest.fixture
def model(tmp_path):
    path = tmp_path / 'model.yaml'
    write_model(MODEL, path)
    return path


def replay(capsys, *arguments):
    status = main(['replay', *map(str, arguments), '--json'])
    out, err = capsys.readouterr()
    return status, json.loads(out) if out else None, err


def columns(path):
    """Read the bag by rosbags' own reader: topic -> stamps and values."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            found.setdefault(connection.topic, []).append(
                (stamp, *message.position, *message.effort))
    return {topic: np.array(rows, object) for topic, rows in found.items()}


def eq_1(y, u, theta):
    from hydro_twin.plants.load_simulator_eq1 import coefficients

    values = [[MODEL.parameters[p.name].value for p in PLANT.parameters]]
    c = coefficients(np.array(values), {'D_m': 2e-5}, 0.002)[0]
    return np.array([c @ [*y[k - 4:k][::-1], *u[k - 4:k + 1][::-1], *theta[k - 4:k + 1][::-1]]
                     for k in range(4, len(y))])


def test_errors_are_those_of_a_reader_and_an_equation_of_ones_own(bag, model, capsys):
    status, result, _ = replay(capsys, bag, '--model', model)
    assert status == 0
    content = columns(bag)
    u = content['/load_simulator/command'][:, 1].astype(float)
    states = content['/load_simulator/joint_states']
    theta, y = states[:, 1].astype(float), states[:, 2].astype(float)
    error, kept = [], []
    for k in range(3):
        part = slice(400 * k, 400 * (k + 1))
        error.append((y[part][4:] - eq_1(y[part], u[part], theta[part]))[1:])    # as [B19]: from
        kept.append(y[part][5:])                                                # order + 1 on
    missed, scored = np.concatenate(error), np.concatenate(kept)
    assert result['samples'] == 1200
    assert result['series'] == 3
    assert result['unit'] == 'N m'
    assert result['one_step']['rmse'] == pytest.approx(np.sqrt(np.mean(missed ** 2)), rel=1e-9)
    fit = 100 * (1 - np.linalg.norm(missed) / np.linalg.norm(scored - scored.mean()))
    assert result['one_step']['fit_percent'] == pytest.approx(fit, rel=1e-9)
    steps = np.concatenate([np.diff(y[400 * k + 4:400 * (k + 1)]) for k in range(3)])
    assert result['persistence']['rmse'] == pytest.approx(np.sqrt(np.mean(steps ** 2)), rel=1e-12)
    assert 0 < result['free_run']['rmse'] < 5
    assert 90 < result['free_run']['fit_percent'] < 100


def test_output_holds_the_input_and_the_predictions_beside_it(bag, model, tmp_path, capsys):
    out = tmp_path / 'out'
    status, _, _ = replay(capsys, bag, '--model', model, '-o', out)
    assert status == 0
    before, after = columns(bag), columns(out)
    for topic, rows in before.items():
        np.testing.assert_array_equal(after[topic], rows)
    states = before['/load_simulator/joint_states']
    one_step = after['/hydro_twin/one_step/prediction']
    free_run = after['/hydro_twin/free_run/prediction']
    stamps = np.concatenate([states[400 * k + 4:400 * (k + 1), 0] for k in range(3)])
    np.testing.assert_array_equal(one_step[:, 0], stamps)
    np.testing.assert_array_equal(free_run[:, 0], stamps)
    y, theta = states[:, 2].astype(float), states[:, 1].astype(float)
    u = before['/load_simulator/command'][:, 1].astype(float)
    expected = np.concatenate([eq_1(*(column[400 * k:400 * (k + 1)] for column in (y, u, theta)))
                               for k in range(3)])
    np.testing.assert_allclose(one_step[:, 1].astype(float), expected, rtol=1e-9, atol=1e-8)


def test_a_config_says_where_signals_are(bag, model, tmp_path, capsys):
    shipped = Path(__file__).parents[2] / 'config' / 'load_simulator.yaml'
    text = shipped.read_text()
    halves = text.split('T_g:')
    config = tmp_path / 'rig.yaml'
    config.write_text(halves[0] + 'T_g:' + halves[1].replace('scale: 1.0', 'scale: 2.0', 1))
    _, plain, _ = replay(capsys, bag, '--model', model)
    status, doubled, _ = replay(capsys, bag, '--model', model, '--config', config)
    assert status == 0
    assert doubled['persistence']['rmse'] == pytest.approx(2 * plain['persistence']['rmse'])


def test_a_run_that_diverges_has_no_error_but_null(bag, tmp_path, capsys):
    wild = replace(MODEL, effects=(
        place('stiffening', 'coupling', {'cubic': 1e13}, PLANT),), substeps=1)
    path = tmp_path / 'wild.yaml'
    write_model(wild, path)
    assert np.isnan(load_predictor(path).free_run(read(bag)[0])).any()
    status, result, _ = replay(capsys, bag, '--model', path)
    assert status == 0
    assert result['free_run'] == {'rmse': None, 'fit_percent': None}


def read(bag):
    from hydro_twin.recording.rig import read as read_bags
    from hydro_twin.recording.rig import rig_of
    return read_bags([bag], rig_of(PLANT)).series


def test_for_a_person(bag, model, capsys):
    assert main(['replay', str(bag), '--model', str(model)]) == 0
    out = capsys.readouterr().out
    assert 'free run' in out
    assert 'RMS error, N m' in out


@pytest.mark.parametrize(('arguments', 'says'), [
    (['BAG'], '--model is needed'),
    (['BAG', '--model', 'nowhere.yaml'], 'nowhere.yaml: no model file'),
    (['nowhere', '--model', 'MODEL'], 'nowhere: no such bag'),
    (['MODEL', '--model', 'MODEL'], 'not a rosbag2 bag'),
    (['BAG', '--model', 'MODEL', '-o', 'BAG'], 'exists already'),
    (['BAG', '--model', 'MODEL', '-o', '/nowhere/out'], 'no folder'),
    (['BAG', '--model', 'MODEL', '--config', 'nowhere.yaml'], 'nowhere.yaml'),
])
def test_bad_input_ends_with_one_line(bag, model, capsys, arguments, says):
    names = {'BAG': bag, 'MODEL': model}
    status, result, err = replay(capsys, *(names.get(a, a) for a in arguments))
    assert status == 2
    assert result is None
    assert says in err
    assert err.count('\n') == 1


def test_a_model_of_another_plant_finds_no_topic(bag, tmp_path, capsys):
    path = tmp_path / 'model.yaml'
    plant = PLANTS['cylinder']
    write_model(Model(plant, {'tau': 0.1, 'K_v': 0.1}, 0.002), path)
    status, _, err = replay(capsys, bag, '--model', path)
    assert status == 2
    assert '/cylinder/' in err
    assert '/load_simulator/joint_states' in err     # and says what there is


def test_a_picture_of_two_models(bag, model, tmp_path, capsys, monkeypatch):
    shown, honest = [], picture.draw

    def draw(recording, plant, runs, errors):
        shown.append(errors)
        return honest(recording, plant, runs, errors)

    monkeypatch.setattr(picture, 'draw', draw)
    status, result, _ = replay(capsys, bag, '--model', model, '--beside', model,
                               '--picture', tmp_path / 'picture.png')
    assert (status, result['picture']) == (0, str(tmp_path / 'picture.png'))
    assert (tmp_path / 'picture.png').read_bytes().startswith(b'\x89PNG')
    assert shown == [{str(model): result['free_run']['rmse']}]


def test_a_picture_of_two_plants_is_refused(bag, model, tmp_path, capsys):
    other = PLANTS['positioning']
    write_model(Model(other, other.constant_values() | other.middle(), 0.002),
                tmp_path / 'other.yaml')
    status, _, err = replay(capsys, bag, '--model', model, '--beside', tmp_path / 'other.yaml',
                            '--picture', tmp_path / 'picture.png')
    assert status == 2
    assert 'other.yaml: a model of positioning' in err
    assert err.count('\n') == 1
    assert not (tmp_path / 'picture.png').exists()


def test_another_model_needs_a_picture(bag, model, capsys):
    status, _, err = replay(capsys, bag, '--model', model, '--beside', model)
    assert (status, err) == (2, 'hydro-twin replay: --beside is for a --picture\n')


def test_ros_arguments_are_for_publishing(capsys):
    assert main(['replay', 'bag', '--ros-args', '-r', 'a:=b']) == 2
    assert capsys.readouterr().err == 'hydro-twin replay: --ros-args: for --publish only\n'


@pytest.mark.parametrize(('arguments', 'says'), [
    (['--model', 'm.yaml', '--rate', '2'], '--rate: for --publish only'),
    (['--model', 'm.yaml', '--loop', '--clock'], '--loop, --clock: for --publish only'),
    (['--publish', '-o', 'out'], '-o: not with --publish, which plays the bag as it is'),
    (['--publish', '--model', 'm.yaml', '--picture', 'p.png'],
     '--model, --picture: not with --publish, which plays the bag as it is'),
])
def test_options_are_for_publishing_or_for_a_model(capsys, arguments, says):
    assert main(['replay', 'bag', *arguments]) == 2
    assert capsys.readouterr().err == f'hydro-twin replay: {says}\n'


@pytest.mark.parametrize(('option', 'place', 'says'), [
    ('-o', 'none/out', 'there is no folder'), ('--picture', 'none/p.png', 'there is no folder'),
    ('--picture', '', 'is a folder')])
def test_where_nothing_can_be_written_is_said_at_once(tmp_path, capsys, option, place, says):
    status, _, err = replay(capsys, 'no bag', '--model', 'no model', option, tmp_path / place)
    assert status == 2
    assert says in err
    assert list(tmp_path.iterdir()) == []


def test_a_model_file_that_is_no_yaml(bag, tmp_path, capsys):
    path = tmp_path / 'model.yaml'
    for text in ('a: 2020-13-45', '[' * 5000):
        path.write_text(text)
        status, _, err = replay(capsys, bag, '--model', path)
        assert (status, err.count('\n')) == (2, 1)
        assert 'model.yaml: not a YAML file' in err


def test_a_wrong_ros_argument_is_one_line(capsys):
    pytest.importorskip('rclpy')
    assert main(['replay', 'bag', '--publish', '--ros-args', '-r', 'a:=']) == 2
    _, err = capsys.readouterr()
    *before, line = err.splitlines()
    assert line.startswith('hydro-twin replay: ')
    assert 'a:=' in line
    assert all('[rcl]' in part for part in before)
