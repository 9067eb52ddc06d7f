"""Networks by `refit`: their options, the hybrid on a model with effects, and what is refused."""
from __future__ import annotations

from importlib.util import find_spec
import json
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.commands.main import main
from hydro_twin.errors import UserError
from hydro_twin.fitting.refit import Refit
from hydro_twin.model import Model, read_model
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.network import Network, network_bytes
from hydro_twin.predictors.network_predictor import load_network

# Not imported to be looked for: that takes seconds of each process that collects the tests.
pytestmark = pytest.mark.skipif(find_spec('torch') is None, reason='needs torch')

RIG = Path(__file__).parents[2] / 'bags' / 'rig_a'


def refit(out: Path, *more: str) -> int:
    return main(['refit', str(RIG), '--plant', 'load_simulator', '-o', str(out), '--json',
                 '--epochs', '60', *more])


@pytest.mark.slow
def test_an_mlp_of_the_structure_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    assert refit(tmp_path / 'm.yaml', '--predictor', 'mlp', '--hidden', '6,5') == 0
    result = json.loads(capsys.readouterr().out)
    assert result['hidden'] == [6, 5]
    assert load_network(tmp_path / 'm.safetensors').sizes[1:-1].tolist() == [6, 5]
    assert np.isfinite(result['test']['one_step'])
    assert main(['replay', str(RIG), '--model', str(tmp_path / 'm.yaml'), '--json']) == 0
    replayed = json.loads(capsys.readouterr().out)['one_step']['rmse']
    both = sorted((result['train']['one_step'], result['test']['one_step']))
    assert both[0] * 0.99 < replayed < both[1] * 1.01


def test_each_model_file_has_weights_of_its_own(tmp_path: Path) -> None:
    network = network_bytes(Network(np.array([14, 1]), np.zeros(15), np.zeros(14), np.ones(14),
                                    1.0, 1.0))
    fitted = Refit(Model(PLANTS['load_simulator'], {'D_m': 2e-5}, 0.002, kind='mlp'), None,
                   network, None, None, {})
    for name in ('rig.v1', 'rig.v2', 'rig.yaml'):
        fitted.save(tmp_path / name)
    assert {path.name for path in tmp_path.iterdir()} == {
        'rig.v1', 'rig.v1.safetensors', 'rig.v2', 'rig.v2.safetensors', 'rig.yaml',
        'rig.safetensors'}
    assert read_model(tmp_path / 'rig.v2').network == 'rig.v2.safetensors'
    with pytest.raises(UserError, match=r'name it .*rig\.yaml'):
        fitted.save(tmp_path / 'rig.safetensors')


@pytest.mark.slow
def test_a_gru_beats_repeating_and_is_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    assert refit(tmp_path / 'm.yaml', '--predictor', 'gru', '--hidden', '8', '--decay',
                 '1e-5') == 0
    result = json.loads(capsys.readouterr().out)
    assert (result['hidden'], result['decay']) == ([8], 1e-5)
    assert result['test']['one_step'] < 0.7 * result['persistence']['test']
    made = read_model(tmp_path / 'm.yaml')
    assert (made.kind, made.parameters) == ('gru', {})
    assert main(['replay', str(RIG), '--model', str(tmp_path / 'm.yaml'), '--json']) == 0
    replayed = json.loads(capsys.readouterr().out)['one_step']['rmse']
    both = sorted((result['train']['one_step'], result['test']['one_step']))
    assert both[0] * 0.95 < replayed < both[1] * 1.05


@pytest.mark.slow
def test_a_hybrid_on_a_model_keeps_its_physics_and_effects(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    base = tmp_path / 'base.yaml'
    assert refit(base, '--criterion', 'one_step') == 0
    text = base.read_text().replace('effects: []', """effects:
- id: friction
  port: motor
  parameters:
    coulomb: {value: 10.0}""")
    base.write_text(text)
    capsys.readouterr()
    hybrid = tmp_path / 'hybrid.yaml'
    assert refit(hybrid, '--predictor', 'hybrid', '--model', str(base), '--hidden', '10') == 0
    result = json.loads(capsys.readouterr().out)
    made, given = read_model(hybrid), read_model(base)
    assert (made.kind, made.parameters, made.effects) == (
        'hybrid', given.parameters, given.effects)
    assert result['test']['one_step'] < 0.5 * result['persistence']['test']


@pytest.mark.parametrize(('more', 'says'), [
    (['--hidden', '7,x'], 'should read like 77,77'),
    (['--hidden', '7'], '--predictor gru, hybrid or mlp'),
    (['--decay', '0'], '--predictor gru, hybrid or mlp'),
    (['--decay', 'nan', '--predictor', 'mlp'], "'nan' should be a number, 0 or above"),
    (['--search', '--predictor', 'gru'], '--search is for hybrid and mlp'),
    (['--hidden', '5,5', '--predictor', 'gru'], 'a GRU has one hidden layer'),
    (['--method', 'pso', '--predictor', 'gru'], 'a GRU has none'),
    (['--method', 'pso', '--predictor', 'mlp'], 'an MLP has none'),
    (['--criterion', 'one_step', '--predictor', 'mlp'], 'an MLP has none'),
    (['--seed', '-1'], "'-1' should be a whole number, 0 or above"),
    (['--hidden', '0'], 'should read like 77,77'),
    (['--epochs', '0', '--predictor', 'mlp'], '--epochs 0'),
    (['--device', 'abacus', '--predictor', 'mlp'], "device 'abacus'"),
    (['--model', 'x.yaml'], 'x.yaml: no model file'),
    (['--model', 'x.yaml', '--fix', 'J=1'], 'for a fresh fit'),
    (['--model', 'x.yaml', '--predictor', 'mlp'], 'an MLP has none'),
    (['--model', 'x.yaml', '--predictor', 'hybrid'], 'x.yaml: no model file'),
])
def test_refuses(
    more: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    try:
        status = refit(tmp_path / 'm.yaml', *more)
    except SystemExit as error:
        status = error.code
    assert status == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
