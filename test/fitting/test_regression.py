import numpy as np
from one_step_problem import eq1, LOWER, recording, SIGNALS, UPPER
import pytest

from hydro_twin.errors import DataError
from hydro_twin.fitting.regression import regression, regressors, triangle
from hydro_twin.recording.series import Series


@pytest.fixture
def stretches():
    return recording(np.sqrt(LOWER * UPPER), np.random.default_rng(0), noise=0.3)


def test_counts_the_patterns_of_the_paper(stretches):
    assert regression(stretches, *SIGNALS).patterns == 3 * 995
    assert regression([s.part(0, 500) for s in stretches], *SIGNALS).patterns == 3 * 495


def test_rows_are_the_samples_that_they_say():
    k = np.arange(12.0)
    series = Series({'y': k, 'u': 100 + k, 'v': 200 + k}, 1.0)
    rows = np.concatenate(list(regressors(series, 'y', ('u', 'v'), 2, block=4)))
    np.testing.assert_array_equal(rows[0], [2, 1, 103, 102, 101, 203, 202, 201, 3])
    np.testing.assert_array_equal(np.diff(rows, axis=0), 1.0)
    assert rows[-1, -1] == 11


def test_rms_is_that_of_a_direct_sum(stretches):
    rng = np.random.default_rng(1)
    population = eq1(rng.uniform(LOWER, UPPER, (50, 9)))
    errors = np.zeros(50)
    for s in stretches:
        y, u, theta = s['T_g'], s['u_m'], s['theta_d']
        for k in range(5, len(s)):
            x = [*y[k - 4:k][::-1], *u[k - 4:k + 1][::-1], *theta[k - 4:k + 1][::-1]]
            errors += (y[k] - population @ x) ** 2
    factor = regression(stretches, *SIGNALS)
    np.testing.assert_allclose(factor.rms(population), np.sqrt(errors / (3 * 995)), rtol=1e-10)
    assert factor.rms(population[3]) == pytest.approx(np.sqrt(errors[3] / (3 * 995)), rel=1e-10)


def test_keeps_precision_where_normal_equations_would_lose_it():
    rng = np.random.default_rng(2)
    truth = np.sqrt(LOWER * UPPER)
    factor = regression(recording(truth, rng), *SIGNALS)
    scale = np.linalg.norm(factor.R[:, -1]) / np.sqrt(factor.patterns)
    assert factor.rms(eq1(truth[None])[0]) < 1e-13 * scale


def test_factors_of_several_recordings_combine(stretches):
    whole = regression(stretches, *SIGNALS)
    parts = regression(stretches[:1], *SIGNALS) + regression(stretches[1:], *SIGNALS)
    assert parts.patterns == whole.patterns
    np.testing.assert_allclose(parts.R.T @ parts.R, whole.R.T @ whole.R, rtol=1e-12)


def test_a_long_stretch_may_come_in_overlapping_pieces(stretches):
    long = stretches[0]
    pieces = (long.part(max(0, begin - 5), begin + 300) for begin in range(0, 1000, 300))
    whole, pieced = regression([long], *SIGNALS), regression(pieces, *SIGNALS)
    assert pieced.patterns == whole.patterns
    np.testing.assert_allclose(pieced.R.T @ pieced.R, whole.R.T @ whole.R, rtol=1e-12)


def test_blocks_give_the_factor_of_the_whole():
    rows = np.random.default_rng(3).standard_normal((500, 6))
    R = triangle(rows[i:i + 7] for i in range(0, 500, 7))
    np.testing.assert_allclose(R.T @ R, rows.T @ rows, rtol=1e-12, atol=1e-12)
    assert triangle([rows[:2]]).shape == (6, 6)


def test_persistence_and_bound_are_those_of_the_samples(stretches):
    factor = regression(stretches, *SIGNALS)
    steps = np.concatenate([np.diff(s['T_g'])[4:] for s in stretches])
    assert factor.persistence() == pytest.approx(np.sqrt(np.mean(steps**2)), rel=1e-10)
    rows = np.concatenate([b for s in stretches for b in regressors(s, *SIGNALS)])
    c = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0]
    direct = np.sqrt(np.mean((rows[:, -1] - rows[:, :-1] @ c) ** 2))
    assert factor.rms(factor.best()) == pytest.approx(direct, rel=1e-9)


def test_bound_holds_where_an_input_never_moves(stretches):
    still = [Series({**s.columns, 'u_m': np.zeros(len(s))}, 0.002) for s in stretches]
    factor = regression(still, *SIGNALS)
    population = eq1(np.random.default_rng(4).uniform(LOWER, UPPER, (200, 9)))
    assert factor.rms(factor.best()) < factor.rms(population).min()


@pytest.mark.parametrize(('damage', 'message'), [
    (lambda c: c['T_g'].__setitem__(500, np.nan), 'T_g .*not finite'),
    (lambda c: c['theta_d'].__setitem__(0, np.inf), 'theta_d .*not finite'),
    (lambda c: c['T_g'].fill(3.0), 'T_g is constant'),
    (lambda c: (c['u_m'].fill(0.0), c['theta_d'].fill(0.1)), 'never change'),
])
def test_refuses_samples_that_cannot_be_fitted(stretches, damage, message):
    damage(stretches[0].columns)
    with pytest.raises(DataError, match=message):
        regression(stretches[:1], *SIGNALS)


def test_refuses_too_few_samples(stretches):
    with pytest.raises(DataError, match='too short: 14 patterns for 14 coefficients'):
        regression([stretches[0].part(0, 19)], *SIGNALS)
    with pytest.raises(DataError, match='too short: 0 patterns'):
        regression([], *SIGNALS)
