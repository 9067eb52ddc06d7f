import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_twin.fitting.identifiability import assess

NAMES = ['a', 'b', 'c']


def jacobian(n):
    t = 0.002 * np.arange(n)
    return np.stack([np.sin(9 * t), np.cos(23 * t), np.sign(np.sin(14 * t))], axis=1)


def test_is_the_textbook_covariance_for_white_residuals():
    n = 100_000
    J, r = jacobian(n), 2.0 * np.random.default_rng(0).standard_normal(n)
    expected = np.sqrt(np.diag(4.0 * np.linalg.inv(J.T @ J)))
    found = assess([(J, r)], NAMES)
    np.testing.assert_allclose(list(found.std_error.values()), expected, rtol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), expected, rtol=0.02)
    assert None not in found.std_error.values()


def test_stretches_add_up():
    rng = np.random.default_rng(1)
    parts = [(jacobian(5000), rng.standard_normal(5000)) for _ in range(4)]
    one, four = assess(parts[:1], NAMES), assess(iter(parts), NAMES)
    for name in NAMES:
        assert four.std_error[name] == pytest.approx(one.std_error[name] / 2, rel=0.1)


@pytest.mark.parametrize('memory', [0.0, 0.9, 0.98])
def test_covers_the_truth_whatever_the_colour(memory):
    rng = np.random.default_rng(2)
    J = jacobian(1500)
    off = []
    for _ in range(100):
        noise = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal((3, 2000)))
        stretches = [(J, e) for e in noise[:, 500:]]
        error = np.linalg.lstsq(np.tile(J, (3, 1)), noise[:, 500:].ravel(), rcond=None)[0]
        found = assess([(J, e - J @ error) for _, e in stretches], NAMES)
        off.append(error / list(found.std_error.values()))
    assert (np.abs(off) < 3).mean(axis=0).min() >= 0.95
    assert np.std(off, axis=0).min() > 0.7              # and not by being too wide


def test_parameters_that_act_together_are_reported_together():
    rng = np.random.default_rng(3)
    J = jacobian(4000)
    J[:, 2] = -J[:, 1]                                  # only b/c acts
    r = rng.standard_normal(4000)
    found = assess([(J, r)], NAMES, [{'b': 1, 'c': -1}])
    alone = assess([(J[:, :2], r)], NAMES[:2])
    assert found.std_error['b'] is None
    assert found.std_error['c'] is None
    assert found.coordinates == ('a', 'b/c')
    assert found.combinations['b/c'] == pytest.approx(alone.std_error['b'])
    assert found.std_error['a'] == pytest.approx(alone.std_error['a'])


def test_finds_a_combination_that_nobody_told_of():
    J = jacobian(4000)
    J[:, 2] = 0.5 * J[:, 1]
    found = assess([(J, np.random.default_rng(4).standard_normal(4000))], NAMES)
    np.testing.assert_allclose(found.factor @ [0.0, 0.5, -1.0], 0.0, atol=1e-6)
    assert found.std_error['b'] is None
    assert found.std_error['c'] is None
    assert found.std_error['a'] is not None


def test_a_parameter_without_effect_is_not_determined():
    J = jacobian(4000)
    J[:, 0] = 0.0
    found = assess([(J, np.random.default_rng(5).standard_normal(4000))], NAMES)
    assert found.std_error['a'] is None


def test_a_parameter_known_only_to_its_own_size_is_not_determined():
    J = jacobian(1000) * [1e-3, 1.0, 1.0]
    found = assess([(J, np.random.default_rng(6).standard_normal(1000))], NAMES)
    assert found.std_error['a'] is None
    assert found.std_error['b'] is not None


def test_what_is_at_its_bound_is_held_there():
    J, r = jacobian(4000), np.random.default_rng(7).standard_normal(4000)
    J[:, 1] = 0.9 * J[:, 0] + 0.1 * J[:, 1]
    free, held = assess([(J, r)], NAMES), assess([(J, r)], NAMES, at_bound=('b',))
    assert held.at_bound == ('b',)
    assert held.std_error['b'] is None
    assert held.std_error['a'] < free.std_error['a']


def test_half_a_combination_at_its_bound_leaves_the_combination():
    J, r = jacobian(4000), np.random.default_rng(8).standard_normal(4000)
    J[:, 2] = J[:, 1]
    whole = assess([(J, r)], NAMES, [{'b': 1, 'c': 1}])
    half = assess([(J, r)], NAMES, [{'b': 1, 'c': 1}], at_bound=('b',))
    assert half.combinations['b*c'] == pytest.approx(whole.combinations['b*c'])
    assert assess([(J, r)], NAMES, [{'b': 1, 'c': 1}], ('b', 'c')).combinations['b*c'] is None
    assert assess([(J, r)], NAMES, at_bound=NAMES).coordinates == ()


def test_a_perfect_fit_has_no_scatter_but_still_its_blind_directions():
    J = jacobian(500)
    J[:, 2] = 2.0 * J[:, 1]
    found = assess([(J, np.zeros(500))], NAMES)
    assert found.std_error == {'a': 0.0, 'b': None, 'c': None}
