"""How far a rig is from its group: against formulas by hand, and what must come out."""
import numpy as np
import pytest
from scipy.stats import norm

from hydro_twin.fleet.factors import Rows
from hydro_twin.fleet.prior import fit_prior
from hydro_twin.fleet.scores import compare_each, surprise


def made(seed, spread, n=11):
    rng = np.random.default_rng(seed)
    s = rng.uniform(0.05, 0.5, n)
    return 2.0 + spread * rng.normal(size=n) + s * rng.normal(size=n), s


@pytest.mark.parametrize('k', [0, 4, 10])
def test_a_score_is_the_deviation_from_the_others(k):
    y, s = made(5, 0.5)
    others = fit_prior([Rows(np.array([[1.0 / error]]), np.array([value / error]))
                        for value, error in zip(np.delete(y, k), np.delete(s, k), strict=True)],
                       np.ones(1))
    expected = (y[k] - others.mean[0]) / np.sqrt(
        s[k] ** 2 + others.spread[0] ** 2 + others.covariance[0, 0])
    assert compare_each(y, s).scores[k] == pytest.approx(expected, rel=1e-4)


def test_an_unusual_rig_shows_and_one_that_does_not_know_does_not():
    rng = np.random.default_rng(0)
    y = 1.0 + 0.05 * rng.normal(size=10)
    s = np.full(10, 0.02)
    y[0], s[0] = 1.9, 1.0                   # far, but it does not know better
    y[1] = 2.0                              # far, and sure of it
    scores = compare_each(y, s).scores
    assert abs(scores[0]) < 2.0
    assert scores[1] > 5.0


def test_one_that_stands_out_does_not_widen_the_spread_of_the_others():
    """The others are scored as if it were not there."""
    rng = np.random.default_rng(4)
    y, s = 1.0 + 0.05 * rng.normal(size=10), np.full(10, 0.05)
    y[6] = 3.0
    found, without = compare_each(y, s), compare_each(np.delete(y, 6), np.delete(s, 6))
    assert list(np.flatnonzero(~found.kept)) == [6]
    assert np.delete(found.scores, 6) == pytest.approx(without.scores)


def test_few_groups_of_rigs_that_are_alike_lose_one():
    rng = np.random.default_rng(5)
    lost = sum(not compare_each(rng.normal(size=10), np.full(10, 0.01)).kept.all()
               for _ in range(300))
    assert lost <= 30


def test_scores_of_rigs_that_are_alike_are_standard_normal():
    rng = np.random.default_rng(1)
    s = rng.uniform(0.1, 1.0, 2000)
    y = 0.5 * rng.normal(size=2000) + s * rng.normal(size=2000)
    scores = compare_each(y, s).scores
    assert np.std(scores) == pytest.approx(1.0, abs=0.05)
    assert np.mean(np.abs(scores) > 1.96) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize('n', [1, 2])
def test_few_rigs_have_no_score(n):
    found = compare_each(np.arange(1.0, n + 1), np.full(n, 0.1))
    assert np.isnan(found.scores).all()
    assert found.kept.all()


def test_an_effect_that_nobody_else_has_is_a_surprise():
    scores = [surprise(0, n) for n in (2, 9, 99)]
    assert scores == sorted(scores)
    assert norm.sf(surprise(0, 9)) == pytest.approx(0.5 / 10)
    assert surprise(9, 9) < 0.0 < surprise(1, 9)
