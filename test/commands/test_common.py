"""Tests of the shared arguments: what they stand for, and what is refused."""
import argparse
from pathlib import Path

import pytest

from hydro_twin.commands import common
from hydro_twin.commands.main import main
from hydro_twin.errors import UserError
from hydro_twin.model import Model, write_model
from hydro_twin.plants import PLANTS
from hydro_twin.progress import progress
from hydro_twin.recording.clock import Clock


def parse(*arguments):
    parser = argparse.ArgumentParser(exit_on_error=False)
    common.add_rig_arguments(parser)
    return parser.parse_args(arguments)


@pytest.fixture
def config(tmp_path):
    """Write a parameter file."""
    def write(text: str) -> Path:
        path = tmp_path / 'rig.yaml'
        path.write_text(f'/**:\n  ros__parameters:\n    {text}\n', encoding='utf-8')
        return path
    return write


def test_defaults_are_those_of_the_plant():
    rig = common.rig_from(parse('--plant', 'load_simulator'))
    assert rig.plant.name == 'load_simulator'
    assert rig.constants == {'D_m': 2.0e-5}
    assert list(rig.signals) == ['u_m', 'theta_d', 'T_g']
    assert rig.signals['T_g'].field == 'effort[0]'
    assert rig.clock == Clock(given=None, usual=0.002, finest=0.002)


def test_command_line_goes_before_configuration(config):
    path = config('{constants: {D_m: 3.0e-5}, sample_time: 0.01, signals: {u_m: {scale: 2.0}}}')
    args = ['--plant', 'load_simulator', '--config', str(path)]
    rig = common.rig_from(parse(*args))
    assert (rig.constants, rig.clock.given) == ({'D_m': 3.0e-5}, 0.01)
    assert (rig.signals['u_m'].scale, rig.signals['theta_d'].scale) == (2.0, 1.0)
    rig = common.rig_from(parse(*args, '--constant', 'D_m=4e-5'))
    assert rig.constants == {'D_m': 4e-5}


@pytest.mark.parametrize('text', ['D_m', 'D_m=', '=2', 'D_m=much'])
def test_a_constant_has_a_name_and_a_value(text):
    with pytest.raises(argparse.ArgumentError, match='should read like'):
        parse('--plant', 'load_simulator', '--constant', text)


@pytest.mark.parametrize(('arguments', 'says'), [
    (['--plant', 'elevator'], 'load_simulator'),
    (['--plant', 'load_simulator', '--constant', 'mass=2'], 'D_m'),
    (['--plant', 'load_simulator', '--constant', 'D_m=-1'], 'positive'),
    (['--plant', 'load_simulator', '--config', '/no/such.yaml'], '/no/such.yaml'),
])
def test_what_is_wrong_is_said_with_what_is_right(arguments, says):
    with pytest.raises(UserError, match=says):
        common.rig_from(parse(*arguments))


def test_a_sample_time_below_zero_is_refused(config):
    path = config('{sample_time: -0.002}')
    with pytest.raises(UserError, match=r'rig\.yaml: sample_time must not be below zero'):
        common.rig_from(parse('--plant', 'load_simulator', '--config', str(path)))


def test_the_command_is_what_main_was_given():
    args = argparse.Namespace(argv=['refit', 'my bag', '-o', 'm.yaml'])
    assert common.command_line(args) == "hydro-twin refit 'my bag' -o m.yaml"


@pytest.mark.parametrize('arguments', [
    ['trace', 'no bag', '--plant', 'load_simulator', '-o', 'out', '--model'],
    ['excitation', 'no bag', '--model']])
def test_an_analytical_model_is_needed(tmp_path, capsys, arguments):
    path = tmp_path / 'mlp.yaml'
    write_model(Model(PLANTS['load_simulator'], {'D_m': 2e-5}, 0.002, kind='mlp',
                      network='mlp.safetensors'), path)
    assert main([*arguments, str(path)]) == 2
    assert capsys.readouterr().err == (f'hydro-twin {arguments[0]}: {path}: a model of kind mlp; '
                                       'an analytical one is needed\n')


def test_progress_goes_to_standard_error(capsys, monkeypatch):
    seconds = iter([0.0, 29.0, 31.0, 60.0, 62.5])
    monkeypatch.setattr('hydro_twin.progress.monotonic', lambda: next(seconds))
    with progress('fitting', total=4) as advance:
        for stage in ('first', 'second', '', ''):
            advance(stage)
    assert capsys.readouterr() == ('', 'fitting, 31 s: second\nfitting, 62 s\n')
