import numpy as np
import pytest

from hydro_twin.studies.b19.populations import METHODS

LOWER, UPPER = np.array([-1.0, 0.0, 10.0]), np.array([2.0, 5.0, 1000.0])
INSIDE = np.array([0.3, 1.2, 700.0])


def bowl(population):
    return np.linalg.norm((population - INSIDE) / (UPPER - LOWER), axis=1)


@pytest.fixture(params=METHODS)
def method(request):
    return METHODS[request.param]


def test_spends_ten_thousand_candidates_all_in_the_box(method):
    seen = []
    method(lambda p: (seen.append(p.copy()), bowl(p))[1], LOWER, UPPER, 1)
    candidates = np.concatenate(seen)
    assert candidates.shape == (10_000, 3)
    assert (candidates >= LOWER).all()
    assert (candidates <= UPPER).all()


def test_reports_the_best_candidate_that_it_saw(method):
    errors = []
    result = method(lambda p: (errors.append(bowl(p)), errors[-1])[1], LOWER, UPPER, 1)
    assert result.error == np.min(errors) == bowl(result.best[None])[0]
    np.testing.assert_array_equal(
        result.history, np.minimum.accumulate([e.min() for e in errors]))
    assert result.history[-1] == result.error


def test_the_same_seed_gives_the_same_search(method):
    first, again, other = (method(bowl, LOWER, UPPER, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first.best, again.best)
    np.testing.assert_array_equal(first.history, again.history)
    assert (first.best != other.best).any()


def test_comes_near_a_minimum_inside(method):
    assert np.median([method(bowl, LOWER, UPPER, seed).error for seed in range(5)]) < 0.03


@pytest.mark.parametrize('name', ['ea', 'pso', 'bees'])
def test_what_learns_beats_chance(name):
    errors = [[METHODS[m](bowl, LOWER, UPPER, seed).error for seed in range(9)]
              for m in (name, 'random')]
    assert np.median(errors[0]) < 0.5 * np.median(errors[1])


def test_finds_a_minimum_in_a_corner(method):
    def corner(population):
        return ((population - LOWER) / (UPPER - LOWER)).sum(axis=1)
    assert method(corner, LOWER, UPPER, 3).error < 0.15


def test_lives_with_candidates_that_have_no_error(method):
    def half(population):
        return np.where(population[:, 0] > 0.0, bowl(population), np.nan)
    result = method(half, LOWER, UPPER, 5)
    assert result.best[0] > 0.0
    assert result.error < 0.1


@pytest.mark.parametrize('error', [2.0, 0.0, np.inf])
def test_survives_an_objective_that_is_flat(method, error):
    assert method(lambda p: np.full(len(p), error), LOWER, UPPER, 0).error == error
