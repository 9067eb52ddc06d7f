"""The files of a trace: all there, right, and all or none."""
from __future__ import annotations

import csv
from dataclasses import replace
import json
import math
import shutil

import numpy as np
import pytest
from test_trace_page import PROVENANCE
from trace_by_hand import evidence, result
import yaml

from hydro_twin.effects import bias, dead_zone, friction_stem, Placed, play
from hydro_twin.errors import UserError
from hydro_twin.fitting.output_error import free_run
from hydro_twin.inference.evaluate import result_of
from hydro_twin.inference.limits import without_unreached
from hydro_twin.model import load_predictor, place, read_model
from hydro_twin.predictors import kernel
from hydro_twin.predictors.scores import errors_of
from hydro_twin.report import trace_files
from hydro_twin.report.summary import sentence
from hydro_twin.report.trace_files import write_files


@pytest.fixture(scope='module')
def traced():
    return evidence('positioning', source='bags/one')


@pytest.fixture(scope='module')
def found(traced):
    return result_of(traced)


@pytest.fixture(scope='module')
def nothing():
    return result('positioning', found=False)


@pytest.fixture(scope='module')
def written(found, tmp_path_factory):
    """Write the files once, for the tests that only read them; (folder, summary)."""
    folder = tmp_path_factory.mktemp('written') / 'out'
    return folder, write_files(found, folder, PROVENANCE)


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob('*') if path.is_file())


def test_where_nothing_is_missing_it_is_said_of_which_model(nothing):
    fits = replace(nothing, verdict='nothing_missing', fails=False)
    assert 'the linear model leaves' in sentence(fits)
    friction = place('friction', 'motor', {'coulomb': 20.0}, fits.plant)
    started = replace(fits, before=replace(fits.before, effects=(friction,)))
    assert 'the model it started from leaves' in sentence(started)


@pytest.mark.parametrize(('unknown', 'says'), [
    (0.005, 'The model lacks friction at the motor: '),
    (0.15, 'The model lacks something that behaves like friction at the motor: '),
    (0.65, 'The model lacks something unexplained, most like friction at the motor: ')])
def test_how_sure_a_name_is_is_said(found, unknown, says):
    (friction,) = found.effects
    friction = replace(friction, law_unknown=unknown, probability=1.0 - unknown)
    assert sentence(replace(found, effects=(friction,))).startswith(says)


def test_effects_are_listed_by_how_sure_they_are(found):
    (friction,) = found.effects
    unknowns = (0.65, 0.15, 0.005, 0.15)
    effects = [module.EFFECT for module in (dead_zone, bias, friction_stem, play)]
    some = tuple(replace(
        friction, placed=Placed(effect, friction.placed.port, (1.0,) * len(effect.parameters)),
        law_unknown=unknown, probability=1.0 - unknown)
        for effect, unknown in zip(effects, unknowns, strict=True))
    assert sentence(replace(found, effects=some)).startswith(
        'The model lacks friction at the motor, and effects that behave like a bias at the motor '
        'and backlash at the motor, and something unexplained, most like a dead zone at the '
        'motor: with them, the ')
    assert sentence(replace(found, effects=(some[2], some[2], some[2]))).startswith(
        'The model lacks friction at the motor, friction at the motor and friction at the motor: ')


def test_a_run_that_diverges_is_reported_and_nothing_is_lost(found, tmp_path):
    errors = {when: {mode: dict(parts) for mode, parts in modes.items()}
              for when, modes in found.before.errors.items()}
    errors['after']['one_step']['test'] = math.nan
    write_files(replace(found, before=found.before.with_record(errors=errors)), tmp_path / 'out',
                PROVENANCE)
    report = json.loads((tmp_path / 'out' / 'report.json').read_text())
    assert report['before']['one_step']['test'] is None
    assert report['before']['free_run'] == found.before.errors['after']['free_run']
    assert read_model(tmp_path / 'out' / 'before.yaml').plant == found.plant


def test_writes_all(written):
    folder, summary = written
    assert names(folder) == [
        'before.yaml', 'figures/effect_friction_motor.png', 'figures/output.png',
        'figures/spectra.png', 'model.yaml', 'report.html', 'report.json', 'series.csv']
    assert json.loads((folder / 'report.json').read_text()) == summary
    for picture in (folder / 'figures').iterdir():
        assert picture.read_bytes().startswith(b'\x89PNG')


def test_the_models_are_those_before_and_after(written, traced):
    before, after = (read_model(written[0] / name) for name in ('before.yaml', 'model.yaml'))
    assert before.effects == ()
    assert [placed.effect.id for placed in after.effects] == ['friction']
    assert before.values['F_v'] == pytest.approx(traced.before.candidate.values['F_v'])


def test_a_limit_that_was_never_reached_is_not_written_as_found(tmp_path):
    """The valve is held at 0.6 and never comes near the lower limit of -10 it was fitted with."""
    made = evidence('valve_servo')
    after = without_unreached(made.after, made.train)
    for part in made.train:
        np.testing.assert_array_equal(free_run(after.candidate, part),
                                      free_run(made.after.candidate, part))
    summary = write_files(result_of(replace(made, after=after)), tmp_path, PROVENANCE)
    assert list(summary['effects'][0]['parameters']) == ['upper']
    raw = yaml.safe_load((tmp_path / 'model.yaml').read_text())
    limits = raw['effects'][0]['parameters']
    assert limits['lower']['std_error'] == 'not reached'
    assert limits['lower']['value'] == -1e9
    assert limits['upper']['std_error'] > 0.0
    again, = read_model(tmp_path / 'model.yaml').effects
    assert again.values == after.candidate.effects[0].values


def test_the_errors_are_those_of_the_models_that_are_written(written, traced):
    folder, summary = written
    for when, name in (('before', 'before.yaml'), ('after', 'model.yaml')):
        expected = errors_of(load_predictor(folder / name), traced.recordings)
        for mode, errors in expected.items():
            assert summary[when][mode] == pytest.approx(errors, rel=1e-12)
            record = read_model(folder / name).record
            assert record.reference_rms(mode) == pytest.approx(errors['test'])


def test_writing_them_runs_no_model(tmp_path, found, monkeypatch):
    def runs(*_):
        raise AssertionError('a model is run')

    for name in ('advance', 'output', 'run', 'run_one_step'):
        monkeypatch.setattr(kernel, name, runs)
    write_files(found, tmp_path, PROVENANCE)
    assert 'report.html' in names(tmp_path)


def from_rest(candidate, part):
    return candidate.system.run(part.inputs,
                                candidate.system.start(part.inputs[0], part.measured[0]))


def test_the_series_hold_every_sample(written, traced):
    with (written[0] / 'series.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    first = [row for row in rows if row['part'] == 'training 1']
    part = traced.train[0]
    assert list(rows[0]) == ['part', 'bag', 'time', 'force', 'x', 'before', 'after']
    assert len(rows) == sum(len(p.measured) for p in (*traced.train, *traced.test))
    assert {row['bag'] for row in rows} == {'bags/one'}
    for name, values in (('time', 0.001 * np.arange(len(part.measured))), ('x', part.measured),
                         ('force', part.inputs[:, 0]),
                         ('before', from_rest(traced.before.candidate, part)),
                         ('after', from_rest(traced.after.candidate, part))):
        np.testing.assert_allclose([float(row[name]) for row in first], values, rtol=1e-8,
                                   atol=1e-15)


def test_figures_of_an_earlier_trace_go(tmp_path, written, nothing):
    shutil.copytree(written[0], tmp_path, dirs_exist_ok=True)
    (tmp_path / 'mine.txt').write_text('kept')
    write_files(nothing, tmp_path, PROVENANCE)
    assert names(tmp_path) == [
        'figures/left_command_command_value.png', 'figures/output.png', 'figures/spectra.png',
        'mine.txt', 'model.yaml', 'report.html', 'report.json', 'series.csv']


def test_nothing_is_replaced_before_all_is_made(tmp_path, written, nothing, monkeypatch):
    shutil.copytree(written[0], tmp_path, dirs_exist_ok=True)
    before = {name: (tmp_path / name).read_bytes() for name in names(tmp_path)}

    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(trace_files, '_pictures', full)
    with pytest.raises(UserError, match='cannot be written \\(No space left'):
        write_files(nothing, tmp_path, PROVENANCE)
    assert {name: (tmp_path / name).read_bytes() for name in names(tmp_path)} == before


def test_a_folder_that_cannot_be_made(tmp_path, found):
    (tmp_path / 'file').write_text('')
    with pytest.raises(UserError, match='cannot be written'):
        write_files(found, tmp_path / 'file' / 'out', PROVENANCE)


@pytest.mark.parametrize('named', [False, True])
def test_a_curve_is_in_the_model_and_said_to_explain_nothing(tmp_path, named):
    made = result('load_simulator', named, True)
    summary = write_files(made, tmp_path, PROVENANCE)
    assert summary['verdict'] == ('effect_found' if named else 'unexplained')
    assert 'curve' not in [effect['id'] for effect in summary['effects']]
    assert summary['found']['explained'] is False
    assert {'before.yaml', 'figures/found_command_value.png'} <= set(names(tmp_path))
    *_, last = read_model(tmp_path / 'model.yaml').effects
    assert last == made.curve.placed
    assert summary['found']['added'] == pytest.approx(last.values[2:])
