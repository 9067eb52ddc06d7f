"""Factors of recordings: against the fit to all of them at once."""
import numpy as np
import pytest
from trace_by_hand import candidate, parts

from hydro_twin.fitting.identifiability import assess
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import get, label, plant_unknowns
from hydro_twin.fleet.factors import Rows, rows_of, together

NAMES = ['a', 'b', 'c']
TRUTH = np.array([2.0, 0.5, -1.0])


def recording(seed, n, shift=0.0):
    """Make a linear problem with white noise of one: regressors and output."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 3)) @ [[2.0, 1.0, 0.0], [0.0, 2.0, 1.0], [0.0, 0.0, 2.0]]
    return X, X @ (TRUTH + shift) + rng.normal(size=n)


def factor(X, y, at):
    """Keep a triangle of a recording, linearised at some values, as a record does."""
    Q, R = np.linalg.qr(X)
    return {'names': NAMES, 'values': list(at), 'rows': R.tolist(),
            'step': (Q.T @ (y - X @ at)).tolist()}


def test_factors_are_the_fit_to_all_recordings():
    """Wherever each was linearised; one more is combined without the others."""
    rng = np.random.default_rng(9)
    recordings = [recording(k, 50 * (k + 1)) for k in range(3)]
    kept = [rows_of(factor(X, y, rng.normal(size=3)), NAMES, [False] * 3) for X, y in recordings]
    rows, chance = together(kept)
    X, y = (np.concatenate(some) for some in zip(*recordings, strict=True))
    values, covariance = rows.solve()
    assert values == pytest.approx(np.linalg.lstsq(X, y, rcond=None)[0])
    assert covariance == pytest.approx(np.linalg.inv(X.T @ X))
    updated, _ = together([together(kept[:2])[0], kept[2]])
    assert updated.solve()[0] == pytest.approx(values)
    assert chance > 0.05


def test_recordings_that_disagree_show():
    kept = [rows_of(factor(*recording(k, 100, k * np.array([0.0, 1.0, 0.0])), np.zeros(3)),
                    NAMES, [False] * 3) for k in range(2)]
    assert together(kept)[1] < 1e-6


def test_recordings_that_agree_seem_to_differ_as_seldom_as_said():
    chances = [together([rows_of(factor(*recording(2 * k + i, 30), np.zeros(3)), NAMES,
                                 [False] * 3) for i in range(2)])[1] for k in range(400)]
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.045)


def test_a_parameter_that_is_eliminated_could_be_anything():
    X, y = recording(5, 200)
    rows = rows_of(factor(X, y, TRUTH), ['c', 'a'], [False] * 2)
    values, covariance = rows.solve()
    assert values == pytest.approx(np.linalg.lstsq(X, y, rcond=None)[0][[2, 0]], rel=1e-3)
    assert covariance == pytest.approx(np.linalg.inv(X.T @ X)[np.ix_([2, 0], [2, 0])], rel=1e-2)


def test_what_is_not_in_a_recording_has_no_rows():
    X, y = recording(6, 100)
    values, covariance = rows_of(factor(X, y, TRUTH), ['d', 'a'], [True, False]).solve()
    assert np.isnan(covariance[0]).all()
    assert values[1] == pytest.approx(np.linalg.lstsq(X, y, rcond=None)[0][0], rel=1e-3)


def test_logarithms_are_taken_about_the_estimate():
    """To first order: a step of one per cent."""
    X, y = recording(7, 100)
    at = np.linalg.lstsq(X, y, rcond=None)[0]
    kept = factor(X, y, at * [1.01, 1.0, 1.0])
    values, covariance = rows_of(kept, NAMES, [True, True, False]).solve()
    plain, spread = rows_of(kept, NAMES, [False] * 3).solve()
    assert np.exp(values[:2]) == pytest.approx(plain[:2], rel=1e-3)
    assert covariance[0, 0] * plain[0] ** 2 == pytest.approx(spread[0, 0], rel=0.03)


def test_the_factor_of_a_fit_is_its_information():
    X, y = recording(8, 400)
    values = np.linalg.lstsq(X, y, rcond=None)[0]
    known = assess([(X, y - X @ values)], NAMES)
    assert known.factor.T @ known.factor @ known.covariance == pytest.approx(np.eye(3), abs=1e-8)
    assert known.step == pytest.approx(np.zeros(3), abs=1e-8)
    away = assess([(X, y - X @ (values + 0.1))], NAMES)
    step = np.linalg.solve(away.factor, away.step)
    assert step == pytest.approx([-0.1] * 3)
    blind = assess([(np.column_stack([X[:, :2], X[:, 1]]), y)], NAMES)
    assert blind.factor.shape == (2, 3)
    assert blind.factor @ [0.0, 1.0, -1.0] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_two_bags_of_a_rig_are_the_fit_to_both():
    """Of an output error, whose step from the two estimates is nearly that of the joint fit."""
    truth = candidate('valve_servo')
    bags = [parts(truth, 2.0, 0.005, seed) for seed in (1, 2)]
    unknowns = plant_unknowns(truth.plant, 'physical')

    def fitted(recordings):
        fit = Problem(truth, unknowns, recordings).solve()
        known = fit.identifiability()
        at = np.log([get(fit.candidate, unknown) for unknown in fit.unknowns])
        assert known.coordinates == tuple(map(label, fit.unknowns))
        return at, Rows(known.factor, known.factor @ at + known.step)

    alone = [fitted(bag) for bag in bags]
    both, rows = fitted([*bags[0], *bags[1]])
    values, covariance = together([rows for _, rows in alone])[0].solve()
    errors = np.sqrt(np.diag(rows.solve()[1]))
    assert (np.abs(values - both) < 0.3 * errors).all()
    assert np.sqrt(np.diag(covariance)) == pytest.approx(errors, rel=0.1)
    assert (np.abs(alone[0][0] - both) > errors).all()
