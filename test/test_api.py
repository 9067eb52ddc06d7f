"""The Python interface: the page's notebook, and that it is what the commands compute."""
from dataclasses import replace
import json
from pathlib import Path
import re
import subprocess
import sys

from matplotlib.figure import Figure
import numpy as np
import pytest

import hydro_twin as ht
from hydro_twin.commands.main import main
from hydro_twin.errors import ModelError, UserError
from hydro_twin.plants import plant_named

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / 'bags' / 'rig_a'


@pytest.fixture(scope='module')
def data():
    return ht.read(BAG, 'load_simulator')


@pytest.fixture(scope='module')
def fit(data):
    return ht.refit(data, ht.Request(criterion='one_step'))


def modules_after(code):
    script = f'import sys, {code}; print(*sys.modules)'
    return set(subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              check=True).stdout.split())


def test_the_import_is_cheap():
    loaded = modules_after('hydro_twin; dir(hydro_twin)')
    assert 'hydro_twin' in loaded
    assert not {'numpy', 'scipy', 'hydro_twin.api', 'argparse'} & loaded


def test_what_only_a_trace_needs_is_imported_when_it_is_used():
    loaded = modules_after('hydro_twin.api')
    assert 'scipy.optimize' in loaded
    assert not {'scipy.stats', 'scipy.signal', 'matplotlib', 'torch'} & loaded


def test_every_name_is_there():
    assert set(dir(ht)) == set(ht.__all__)
    assert all(getattr(ht, name).__doc__ for name in ht.__all__)
    with pytest.raises(AttributeError, match="no attribute 'refti'"):
        ht.refti        # noqa: B018


def test_refit_is_that_of_the_command(fit, tmp_path, capsys):
    assert main(['refit', str(BAG), '--plant', 'load_simulator', '--criterion', 'one_step', '-o',
                 str(tmp_path / 'm.yaml'), '--json']) == 0
    printed = json.loads(capsys.readouterr().out)
    del printed['model']
    assert printed == json.loads(json.dumps(fit.summary()))


def test_a_model_that_is_saved_runs_as_the_one_that_is_not(data, fit, tmp_path):
    fit.save(tmp_path / 'm.yaml')
    series = data.recording.series[0]
    read = ht.read_model(tmp_path / 'm.yaml')
    for mode in ('one_step', 'free_run', 'observer'):
        predicted = read.run(series, mode)
        assert predicted.shape == series['T_g'].shape
        np.testing.assert_array_equal(predicted, fit.model.run(series, mode))
        np.testing.assert_array_equal(
            predicted, getattr(ht.load_predictor(tmp_path / 'm.yaml'), mode)(series))


def test_replay_is_that_of_the_command(data, fit, tmp_path, capsys):
    fit.save(tmp_path / 'm.yaml')
    replay = ht.replay(data, fit.model)
    assert main(['replay', str(BAG), '--model', str(tmp_path / 'm.yaml'), '--json']) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(replay.summary()))
    figure = replay.figure('fit')
    assert isinstance(figure, Figure)
    (line,) = (line for line in figure.axes[0].lines if line.get_label() == 'fit, free run')
    np.testing.assert_array_equal(line.get_ydata(),
                                  fit.model.run(data.recording.series[0])[:1000])


def test_what_does_not_go_together_is_one_line(data, fit):
    with pytest.raises(UserError, match='are for networks: --predictor gru, hybrid or mlp'):
        ht.refit(data, ht.Request(hidden=(3,)))
    with pytest.raises(UserError, match="no method 'guess'"):
        ht.refit(data, ht.Request(method='guess'))
    with pytest.raises(ModelError, match="predictor 'oracle'; there are analytical, "):
        ht.refit(data, ht.Request('oracle'))
    with pytest.raises(UserError, match="no plant 'servo'"):
        ht.read(BAG, 'servo')
    with pytest.raises(ModelError, match=r'a series of 0\.002 s; the model runs at 0\.01 s'):
        fit.model.at(0.01).run(data.recording.series[0])
    with pytest.raises(UserError, match='no bags are given'):
        ht.read([], 'load_simulator')
    with pytest.raises(UserError, match="no criterion 'freerun'; there are free_run, one_step"):
        ht.refit(data, ht.Request(criterion='freerun'))


def test_a_model_of_another_plant_than_the_data_is_refused(data, fit):
    other = replace(data, rig=replace(data.rig, plant=plant_named('cylinder')))
    for use in (ht.replay, ht.trace, ht.excitation):
        with pytest.raises(UserError, match='a model of load_simulator; the data are of cylinder'):
            use(other, fit.model)
    with pytest.raises(UserError, match='a model of load_simulator; the data are of cylinder'):
        ht.replay(other, fit.predictor)


def test_a_model_file_may_be_named_by_text(fit, tmp_path):
    path = str(tmp_path / 'm.yaml')
    fit.save(path)
    assert ht.read_model(path).values == fit.model.values
    assert ht.load_predictor(path).model.values == fit.model.values


@pytest.mark.slow
def test_the_notebook_of_the_page_runs(tmp_path, monkeypatch):
    (code,) = re.findall(r'```python\n(.*?)```', (ROOT / 'docs' / 'api.md').read_text('utf-8'),
                         re.DOTALL)
    (tmp_path / 'bags').symlink_to(ROOT / 'bags')
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(code, names)
    assert names['trace'].result.verdict == 'effect_found'
    assert {path.stem for path in (tmp_path / 'traced' / 'figures').iterdir()} == set(
        names['figures'])
    assert all(isinstance(figure, Figure) for figure in names['figures'].values())
    report = json.loads((tmp_path / 'traced' / 'report.json').read_text('utf-8'))
    assert report == json.loads(json.dumps(names['trace'].summary()))
    np.testing.assert_array_equal(
        names['predicted'], ht.read_model(tmp_path / 'traced' / 'model.yaml').run(
            names['data'].recording.series[0]))
