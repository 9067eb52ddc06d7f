"""The result of a trace: computed once, and what it says of its models."""
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from trace_by_hand import evidence

from hydro_twin.inference.evaluate import result_of
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import errors_of
from hydro_twin.recording.series import Recording


@pytest.mark.parametrize('found', [True, False])
def test_each_model_predicts_each_series_once(monkeypatch, found):
    made = evidence('positioning', found)
    predicted = Counter()

    def counted(mode):
        honest = getattr(Analytical, mode)

        def count(self, series):
            predicted[mode, self.model.effects, id(series)] += 1
            return honest(self, series)

        return count

    for mode in ('one_step', 'free_run'):
        monkeypatch.setattr(Analytical, mode, counted(mode))
    result_of(made)
    models, series = (2 if found else 1), 6
    assert predicted.total() == len(predicted) == models * 2 * series


def of_the_same_series(made):
    """Let both parts be cut from the same series; they have the same inputs."""
    return replace(made, recordings={part: Recording(tuple(
        replace(one, whole=whole) for one, whole in zip(
            recording.series, made.recordings['train'].series, strict=True)))
        for part, recording in made.recordings.items()})


def test_the_errors_are_those_of_a_run_of_the_models():
    made = of_the_same_series(evidence('load_simulator'))
    result = result_of(made)
    for model in (result.before, result.after):
        expected = errors_of(Analytical(model), made.recordings)
        for mode, errors in expected.items():
            assert model.errors['after'][mode] == pytest.approx(errors, rel=1e-12)
    assert result.before.errors['before'] == result.after.errors['before']
    assert [run.label for run in result.runs] == [
        f'{part} {k}' for part in ('test', 'training') for k in (1, 2, 3)]
    for part, runs in (('test', result.runs[:3]), ('train', result.runs[3:])):
        missed = [(run.measured - run.after)[run.first:] for run in runs]
        assert np.sqrt(np.mean(np.concatenate(missed) ** 2)) == pytest.approx(
            result.after.errors['after']['free_run'][part])
        for run, row, error in zip(runs, result.series, missed, strict=True):
            assert row.after['free_run'][part] == pytest.approx(np.sqrt(np.mean(error ** 2)))
            assert row.bag == run.series.source


def test_a_series_has_no_test_error_of_another_bag():
    """Where others test, or where its own held-out part is too short to be scored."""
    made = of_the_same_series(evidence('load_simulator'))
    train, test = made.recordings.values()
    apart = replace(made, recordings={'train': train, 'test': Recording(tuple(
        replace(one, whole=None) for one in test.series))})
    first = test.series[0]
    short = replace(made, recordings={'train': train, 'test': Recording((
        replace(first.part(0, 20), whole=first.whole), *test.series[1:]))})
    for changed, tested in ((apart, []), (short, ['', 'test', 'test'])):
        rows = result_of(changed).series
        assert len(rows) == 3
        for row, part in zip(rows, tested or [''] * 3, strict=True):
            assert set(row.after['free_run']) == {'train', part} - {''}
