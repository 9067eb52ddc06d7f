"""The prior of a group: against the likelihood itself, and what must come out."""
from functools import partial

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from hydro_twin.fleet.factors import Rows
from hydro_twin.fleet.prior import fit_prior

MEAN = np.array([1.0, -2.0])


def made(seed, spread, n=12):
    """Make recordings that determine two parameters badly, each in its own direction."""
    rng = np.random.default_rng(seed)
    rigs = []
    for _ in range(n):
        R = rng.normal(size=(3, 2)) * [4.0, 2.0]
        rigs.append(Rows(R, R @ (MEAN + spread * rng.normal(size=2)) + rng.normal(size=3)))
    return rigs


def contrasts(log, rigs):
    """Return the negative log-density of what does not depend on the mean: what defines REML."""
    A, z = np.vstack([rig.R for rig in rigs]), np.concatenate([rig.z for rig in rigs])
    V = block_diag(*(np.eye(3) + rig.R @ np.diag(np.exp(2.0 * log)) @ rig.R.T for rig in rigs))
    free = null_space(A.T).T
    return -multivariate_normal.logpdf(free @ z, np.zeros(len(free)), free @ V @ free.T)


@pytest.mark.parametrize('seed', range(3))
def test_the_spread_is_that_of_the_restricted_likelihood(seed):
    rigs = made(seed, np.array([0.5, 1.0]))
    found = fit_prior(rigs, np.ones(2))
    expected = minimize(partial(contrasts, rigs=rigs), np.log([0.5, 1.0]), method='Nelder-Mead',
                        options={'xatol': 1e-6, 'fatol': 1e-10})
    assert found.spread == pytest.approx(np.exp(expected.x), rel=1e-3)


def test_the_unit_does_not_matter():
    rigs, scale = made(1, 0.5), np.array([1e-12, 1e5])
    one = fit_prior(rigs, np.ones(2))
    other = fit_prior([Rows(rig.R / scale, rig.z) for rig in rigs], scale)
    assert other.mean == pytest.approx(one.mean * scale, rel=1e-4)
    assert other.spread == pytest.approx(one.spread * scale, rel=1e-3)


def test_a_rig_with_its_group_is_the_conditional_mean_of_all_together():
    """By the joint normal distribution of all recordings and parameters, with a flat mean."""
    rigs = made(3, 0.4)
    found = fit_prior(rigs, np.ones(2))
    n = len(rigs)
    scatter = np.kron(np.eye(n), np.diag(found.spread ** 2)) + 1e6 * np.kron(
        np.ones((n, n)), np.eye(2))
    R = block_diag(*(rig.R for rig in rigs))
    posterior = np.linalg.inv(np.linalg.inv(scatter) + R.T @ R)
    x = (posterior @ R.T @ np.concatenate([rig.z for rig in rigs])).reshape(n, 2)
    errors = np.sqrt(np.diag(posterior)).reshape(n, 2)
    for k, rig in enumerate(rigs):
        values, std_errors = found.with_rig(rig)
        assert values == pytest.approx(x[k], rel=1e-4)
        assert std_errors == pytest.approx(errors[k], rel=1e-4)


def test_what_a_recording_leaves_open_is_borrowed():
    """One knows the sum of its two parameters only; with the group it knows both."""
    rigs = made(4, 0.1, 30)
    found = fit_prior(rigs, np.ones(2))
    sum_only = Rows(np.array([[50.0, 50.0]]), np.array([50.0 * -0.7]))
    values, errors = found.with_rig(sum_only)
    assert sum(values) == pytest.approx(-0.7, abs=0.02)
    assert values == pytest.approx(found.mean + 0.15, abs=0.15)
    assert (errors < 0.3).all()


def test_it_borrows_nothing_of_what_is_its_own():
    rigs = made(5, 0.1)
    found = fit_prior(rigs, np.ones(2))
    alone = Rows(np.diag([10.0, 10.0]), np.array([70.0, 70.0]))
    values, errors = found.with_rig(alone, [0])
    assert (values[0], errors[0]) == pytest.approx((7.0, 0.1))
    assert values[1] < 7.0 - 0.5


def test_a_single_rig_is_what_is_usual():
    (rig,) = made(6, 0.0, 1)
    found = fit_prior([rig], np.ones(2))
    expected = np.linalg.lstsq(rig.R, rig.z, rcond=None)[0]
    assert found.mean == pytest.approx(expected)
    assert found.with_rig(rig)[0] == pytest.approx(expected, rel=1e-5)
