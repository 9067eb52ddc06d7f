"""The least squares of the search for starts, against numpy."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.fitting.start_search import explain_each, miss_each


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def explain(columns, parts, missed, counts, ridges):
    c = columns.shape[2]
    moves, power = np.empty((len(parts), c)), np.empty(len(parts))
    explain_each(columns, parts, missed, counts, ridges, np.empty((c, c + 1)), moves, power)
    return moves, power


def test_moves_are_those_of_damped_least_squares(rng):
    columns, missed = rng.standard_normal((4, 30, 3)), rng.standard_normal((2, 30))
    counts, ridges, parts = np.array([30, 20, 30, 11]), np.full(4, 0.3), np.array([3, 1])
    moves, power = explain(columns, parts, missed, counts, ridges)
    for k, part in enumerate(parts):
        n = counts[part]
        rows = np.vstack([columns[part, :n], np.sqrt(0.3) * np.eye(3)])
        expected = np.linalg.lstsq(rows, np.concatenate([missed[k, :n], np.zeros(3)]))[0]
        assert moves[k] == pytest.approx(expected, rel=1e-9)
        left = missed[k, :n] - columns[part, :n] @ expected
        assert power[k] == pytest.approx(left @ left, rel=1e-9)


def test_a_coordinate_that_shows_nothing_stays(rng):
    columns = rng.standard_normal((1, 30, 3))
    columns[..., 1] = 0.0
    moves, _ = explain(columns, np.array([0]), rng.standard_normal((1, 30)), np.array([30]),
                       np.array([1e-3]))
    assert moves[0, 1] == 0.0
    assert moves[0, [0, 2]].all()


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_run_that_diverged_moves_nothing(rng, value):
    missed = rng.standard_normal((1, 30))
    missed[0, 20:] = value
    moves, power = explain(rng.standard_normal((1, 30, 3)), np.array([0]), missed,
                           np.array([30]), np.array([1e-3]))
    assert not moves.any()
    assert not power[0] < np.inf


def test_only_the_samples_of_a_part_count(rng):
    measured, y = rng.standard_normal((3, 30)), rng.standard_normal((2, 30))
    counts, parts = np.array([30, 12, 5]), np.array([2, 0])
    missed, power = y.copy(), np.empty(2)
    miss_each(measured, parts, counts, missed, power)
    for k, part in enumerate(parts):
        expected = measured[part, :counts[part]] - y[k, :counts[part]]
        np.testing.assert_array_equal(missed[k, :counts[part]], expected)
        assert power[k] == pytest.approx(expected @ expected, rel=1e-12)
