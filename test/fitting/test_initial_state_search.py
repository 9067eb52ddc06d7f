"""The least squares of the search for initial states, against numpy."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.fitting.initial_state_search import ridge_regressions, to_residuals


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def regress(jacobian, parts, residual, counts, ridges):
    c = jacobian.shape[2]
    steps, squares = np.empty((len(parts), c)), np.empty(len(parts))
    ridge_regressions(jacobian, parts, residual, counts, ridges, np.empty((c, c + 1)), steps,
                      squares)
    return steps, squares


def test_steps_are_those_of_ridge_regression(rng):
    jacobian, residual = rng.standard_normal((4, 30, 3)), rng.standard_normal((2, 30))
    counts, ridges, parts = np.array([30, 20, 30, 11]), np.full(4, 0.3), np.array([3, 1])
    steps, squares = regress(jacobian, parts, residual, counts, ridges)
    for k, part in enumerate(parts):
        n = counts[part]
        rows = np.vstack([jacobian[part, :n], np.sqrt(0.3) * np.eye(3)])
        expected = np.linalg.lstsq(rows, np.concatenate([residual[k, :n], np.zeros(3)]))[0]
        assert steps[k] == pytest.approx(expected, rel=1e-9)
        left = residual[k, :n] - jacobian[part, :n] @ expected
        assert squares[k] == pytest.approx(left @ left, rel=1e-9)


def test_a_coordinate_that_shows_nothing_stays(rng):
    jacobian = rng.standard_normal((1, 30, 3))
    jacobian[..., 1] = 0.0
    steps, _ = regress(jacobian, np.array([0]), rng.standard_normal((1, 30)), np.array([30]),
                       np.array([1e-3]))
    assert steps[0, 1] == 0.0
    assert steps[0, [0, 2]].all()


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_run_that_diverged_moves_nothing(rng, value):
    residual = rng.standard_normal((1, 30))
    residual[0, 20:] = value
    steps, squares = regress(rng.standard_normal((1, 30, 3)), np.array([0]), residual,
                             np.array([30]), np.array([1e-3]))
    assert not steps.any()
    assert not squares[0] < np.inf


def test_only_the_samples_of_a_part_count(rng):
    measured, y = rng.standard_normal((3, 30)), rng.standard_normal((2, 30))
    counts, parts = np.array([30, 12, 5]), np.array([2, 0])
    residual, squares = y.copy(), np.empty(2)
    to_residuals(measured, parts, counts, residual, squares)
    for k, part in enumerate(parts):
        expected = measured[part, :counts[part]] - y[k, :counts[part]]
        np.testing.assert_array_equal(residual[k, :counts[part]], expected)
        assert squares[k] == pytest.approx(expected @ expected, rel=1e-12)
