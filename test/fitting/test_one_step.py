import numpy as np
from one_step_problem import COMBINATIONS, eq1, LOWER, NAMES, recording, SIGNALS, UPPER
import pytest

from hydro_twin.fitting.identifiability import assess
from hydro_twin.fitting.one_step import (
    at_bound,
    derivative,
    embedding,
    least_squares,
    one_step_error,
    sensitivities,
)
from hydro_twin.fitting.regression import Regression, regression, regressors
from hydro_twin.studies.b19.populations import METHODS

KNOWN = ['J', 'K_p', 'G', 'K_ce', 'B_m']


def fit(factor, seed=0):
    return least_squares(factor, eq1, NAMES, COMBINATIONS, LOWER, UPPER, seed)


def truth_and_factor(seed, **how):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.9 * LOWER + 0.1 * UPPER, 0.1 * LOWER + 0.9 * UPPER)
    stretches = recording(truth, rng, **how)
    return truth, stretches, regression(stretches, *SIGNALS)


def combined(parameters):
    p = dict(zip(NAMES, parameters, strict=True))
    return np.array([*(p[name] for name in KNOWN), p['V_m'] / p['beta_e'], p['K_q'] * p['K_sv']])


def test_slopes_are_those_of_central_differences():
    p = np.sqrt(LOWER * UPPER)
    slope = derivative(eq1, p)
    for i in range(9):
        step = np.eye(9)[i] * 1e-5
        difference = (eq1(p * np.exp(step)[None]) - eq1(p * np.exp(-step)[None]))[0] / 2e-5
        np.testing.assert_allclose(slope[:, i], difference, rtol=1e-6, atol=1e-6)


def test_coordinates_cover_the_box_and_nothing_else():
    origin, M = embedding(NAMES, COMBINATIONS, LOWER, UPPER)
    assert M.shape == (9, 7)
    corners = np.exp(origin + np.array([np.zeros(7), np.ones(7)]) @ M.T)
    low, high = combined(corners[0]), combined(corners[1])
    np.testing.assert_allclose(low[-2:], [1.6e-4 / 7.5e8, 0.2 * 3e-5])
    np.testing.assert_allclose(high[-2:], [1.9e-4 / 6.5e8, 2.5 * 2e-4])
    np.testing.assert_allclose([low[0], high[0]], [1e-2, 1e-1])


@pytest.mark.parametrize('seed', range(4))
def test_recovers_what_can_be_known_exactly(seed):
    truth, _, factor = truth_and_factor(seed)
    result = fit(factor)
    np.testing.assert_allclose(combined(result.best), combined(truth), rtol=1e-7)
    assert ((result.best >= LOWER) & (result.best <= UPPER)).all()


@pytest.mark.parametrize('kind', ['right', 'friction', 'noise', 'unphysical'])
@pytest.mark.parametrize('seed', range(4))
def test_never_ends_above_the_best_of_the_four(kind, seed):
    _, _, factor = truth_and_factor(seed, noise=0.3, friction=10.0 * (kind == 'friction'))
    rng = np.random.default_rng(seed)
    if kind == 'noise':
        factor = Regression(np.triu(rng.standard_normal((15, 15))), 100)
    if kind == 'unphysical':
        c = factor.best() * rng.uniform(0.8, 1.2, 14)
        R = factor.R.copy()
        R[:, -1] = R[:, :-1] @ c
        factor = Regression(R, factor.patterns)
    objective = one_step_error(factor, eq1)
    others = min(search(objective, LOWER, UPPER, seed).error for search in METHODS.values())
    assert fit(factor, seed).error <= others * (1 + 1e-9)


def test_the_unconstrained_bound_lies_below():
    _, _, factor = truth_and_factor(5, noise=0.3, friction=10.0)
    assert factor.rms(factor.best()) < fit(factor).error


def test_the_same_seed_gives_the_same_fit():
    _, _, factor = truth_and_factor(6, noise=0.3)
    np.testing.assert_array_equal(fit(factor, 3).best, fit(factor, 3).best)


def test_names_what_stopped_at_a_bound():
    truth = np.sqrt(LOWER * UPPER)
    truth[NAMES.index('J')] = UPPER[NAMES.index('J')] * 1.5
    factor = regression(recording(truth, np.random.default_rng(7), noise=0.1), *SIGNALS)
    assert 'J' in at_bound(NAMES, fit(factor).best, LOWER, UPPER)
    assert at_bound(NAMES, np.sqrt(LOWER * UPPER), LOWER, UPPER) == ()


def test_sensitivities_are_those_of_the_residual():
    _, stretches, factor = truth_and_factor(8, noise=0.3)
    p = fit(factor).best
    rows = np.concatenate([b for s in stretches for b in regressors(s, *SIGNALS)])
    pieces = list(sensitivities(stretches, *SIGNALS, eq1, p))
    residual = np.concatenate([r for _, r in pieces])
    np.testing.assert_allclose(residual, rows[:, -1] - rows[:, :-1] @ eq1(p[None])[0])
    raised = p * np.exp(1e-6 * np.eye(9)[NAMES.index('G')])
    change = (rows[:, :-1] @ (eq1(raised[None]) - eq1(p[None]))[0]) / 1e-6
    jacobian = np.concatenate([j for j, _ in pieces])
    np.testing.assert_allclose(jacobian[:, NAMES.index('G')], change, rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_standard_errors_cover_the_truth():
    inside, total = 0, 0
    for seed in range(40):
        truth, stretches, factor = truth_and_factor(seed, noise=0.2)
        found = fit(factor).best
        edge = at_bound(NAMES, found, LOWER, UPPER)
        what = assess(sensitivities(stretches, *SIGNALS, eq1, found), NAMES, COMBINATIONS, edge)
        errors = [*(what.std_error[name] for name in KNOWN), *what.combinations.values()]
        off = np.abs(np.log(combined(found) / combined(truth)))
        for e, distance in zip(errors, off, strict=True):
            if e is not None:
                inside += distance < 3 * e
                total += 1
    assert total > 0.8 * 40 * 7
    assert inside >= 0.95 * total
