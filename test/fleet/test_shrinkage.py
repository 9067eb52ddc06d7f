"""Shared strength: against the likelihood itself, formulas by hand, and what must come out."""
import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import curve_fit, minimize_scalar
from scipy.stats import multivariate_normal, norm

from hydro_twin.fleet.shrinkage import shrink, surprise
from hydro_twin.fleet.summary import line


def made(seed, spread, n=11):
    rng = np.random.default_rng(seed)
    s = rng.uniform(0.05, 0.5, n)
    return 2.0 + spread * rng.normal(size=n) + s * rng.normal(size=n), s


def restricted(y, s):
    """Find the variance between rigs, by its logarithm, at which contrasts are likeliest.

    This is what defines the restricted likelihood: the density of A y where A 1 = 0, so that the
    mean does not matter.
    """
    contrasts = null_space(np.ones((1, len(y)))).T
    return minimize_scalar(
        lambda log: -multivariate_normal.logpdf(
            contrasts @ y, np.zeros(len(y) - 1),
            contrasts @ np.diag(s ** 2 + np.exp(log)) @ contrasts.T),
        bounds=(-25, 5), method='bounded', options={'xatol': 1e-10})


@pytest.mark.parametrize('seed', range(8))
@pytest.mark.parametrize('spread', [0.0, 0.3, 3.0])
def test_the_spread_is_that_of_the_restricted_likelihood(seed, spread):
    y, s = made(seed, spread)
    assert shrink(y, s).spread ** 2 == pytest.approx(np.exp(restricted(y, s).x), rel=1e-4,
                                                     abs=1e-5)


def test_the_shrunken_values_are_the_conditional_mean_of_all_rigs_together():
    """By the joint normal distribution of estimates and true values, with a flat prior of mu."""
    y, s = made(3, 0.4)
    found = shrink(y, s)
    n = len(y)
    prior = np.linalg.inv(found.spread ** 2 * np.eye(n) + 1e6)
    posterior = np.linalg.inv(prior + np.diag(s ** -2))
    assert found.values == pytest.approx(posterior @ (y / s ** 2), rel=1e-5)
    assert found.errors == pytest.approx(np.sqrt(np.diag(posterior)), rel=1e-4)


@pytest.mark.parametrize('k', [0, 4, 10])
def test_a_score_is_the_deviation_from_the_others(k):
    y, s = made(5, 0.5)
    others = shrink(np.delete(y, k), np.delete(s, k))
    expected = (y[k] - others.mean) / np.sqrt(
        s[k] ** 2 + others.spread ** 2 + others.std_error ** 2)
    assert shrink(y, s).scores[k] == pytest.approx(expected, rel=1e-6)


def test_without_spread_all_have_the_pooled_mean():
    s = np.array([0.1, 0.2, 0.4])
    y = np.array([1.0, 1.01, 0.99])
    found = shrink(y, s)
    pooled = np.average(y, weights=s ** -2)
    assert found.spread == 0.0
    assert found.values == pytest.approx([pooled] * 3)
    assert found.errors == pytest.approx([np.sum(s ** -2) ** -0.5] * 3)


def test_with_a_large_spread_each_keeps_its_own_value():
    s = np.array([0.1, 0.2, 0.1, 0.2])
    y = np.array([-300.0, 100.0, 500.0, 900.0])
    found = shrink(y, s)
    assert found.values == pytest.approx(y, abs=1e-3)
    assert found.errors == pytest.approx(s, rel=1e-3)


def test_a_rig_with_little_data_borrows_and_an_unusual_one_shows():
    rng = np.random.default_rng(0)
    y = 1.0 + 0.05 * rng.normal(size=10)
    s = np.full(10, 0.02)
    y[0], s[0] = 1.9, 1.0                   # far, but it does not know better
    y[1] = 2.0                              # far, and sure of it
    found = shrink(np.delete(y, 1), np.delete(s, 1))
    assert abs(found.values[0] - 1.0) < 0.1
    assert found.errors[0] < 0.1
    scores = shrink(y, s).scores
    assert abs(scores[0]) < 2.0
    assert scores[1] > 5.0


def test_one_that_stands_out_does_not_widen_the_spread_of_the_others():
    """What is left is the fit without it; it keeps its own value."""
    rng = np.random.default_rng(4)
    y, s = 1.0 + 0.05 * rng.normal(size=10), np.full(10, 0.05)
    y[6] = 3.0
    found, without = shrink(y, s), shrink(np.delete(y, 6), np.delete(s, 6))
    assert list(np.flatnonzero(~found.kept)) == [6]
    assert (found.mean, found.spread) == pytest.approx((without.mean, without.spread))
    assert np.delete(found.values, 6) == pytest.approx(without.values)
    assert (found.values[6], found.errors[6]) == (3.0, 0.05)
    assert np.delete(found.scores, 6) == pytest.approx(without.scores)


def test_few_groups_of_rigs_that_are_alike_lose_one():
    rng = np.random.default_rng(5)
    lost = sum(not shrink(rng.normal(size=10), np.full(10, 0.01)).kept.all() for _ in range(300))
    assert lost <= 30


def test_scores_of_rigs_that_are_alike_are_standard_normal():
    rng = np.random.default_rng(1)
    s = rng.uniform(0.1, 1.0, 2000)
    y = 0.5 * rng.normal(size=2000) + s * rng.normal(size=2000)
    scores = shrink(y, s).scores
    assert np.std(scores) == pytest.approx(1.0, abs=0.05)
    assert np.mean(np.abs(scores) > 1.96) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize('n', [1, 2])
def test_few_rigs_have_no_score(n):
    found = shrink(np.arange(1.0, n + 1), np.full(n, 0.1))
    assert np.isnan(found.scores).all()
    assert np.isfinite(found.values).all()


def test_an_effect_that_nobody_else_has_is_a_surprise():
    scores = [surprise(0, n) for n in (2, 9, 99)]
    assert scores == sorted(scores)
    assert norm.sf(surprise(0, 9)) == pytest.approx(0.5 / 10)
    assert surprise(9, 9) < 0.0 < surprise(1, 9)


def test_a_trend_is_the_line_of_least_squares():
    rng = np.random.default_rng(2)
    x, s = np.array([0.0, 0.3, 0.5, 1.0]), np.array([0.1, 0.2, 0.1, 0.3])
    y = 1.0 + 0.7 * x + s * rng.normal(size=4)
    (slope, _), known = curve_fit(lambda x, a, b: a * x + b, x, y, sigma=s, absolute_sigma=True)
    _, scaled = curve_fit(lambda x, a, b: a * x + b, x, y, sigma=s)
    found = line(x, y, s)
    assert (found.slope, found.std_error) == pytest.approx((slope, known[0, 0] ** 0.5), rel=1e-5)
    assert found.ratio == pytest.approx(scaled[0, 0] / known[0, 0], rel=1e-5)
    assert found.free == 2
