"""The search for initial states: its least squares against numpy, and a hysteresis."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.fitting.initial_state_descent import regress
from hydro_twin.fitting.output_error import initial_states
from hydro_twin.fitting.parts import Part
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def ridge_regression(jacobian, residual, count, ridge):
    c = jacobian.shape[1]
    found = np.empty((c, 1))
    squares = regress(jacobian, residual, count, ridge, np.empty((c, c)), found)
    return found[:, 0], squares


@pytest.mark.parametrize('count', [30, 11])
def test_a_step_is_that_of_ridge_regression(rng, count):
    """Over the samples of the part alone."""
    jacobian, residual = rng.standard_normal((30, 3)), rng.standard_normal(30)
    step, squares = ridge_regression(jacobian, residual, count, 0.3)
    rows = np.vstack([jacobian[:count], np.sqrt(0.3) * np.eye(3)])
    expected = np.linalg.lstsq(rows, np.concatenate([residual[:count], np.zeros(3)]))[0]
    assert step == pytest.approx(expected, rel=1e-9)
    left = residual[:count] - jacobian[:count] @ expected
    assert squares == pytest.approx(left @ left, rel=1e-9)


def test_a_coordinate_that_shows_nothing_stays(rng):
    jacobian = rng.standard_normal((30, 3))
    jacobian[:, 1] = 0.0
    step, _ = ridge_regression(jacobian, rng.standard_normal(30), 30, 1e-3)
    assert step[1] == 0.0
    assert step[[0, 2]].all()


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_run_that_diverged_moves_nothing(rng, value):
    residual = rng.standard_normal(30)
    residual[20:] = value
    step, squares = ridge_regression(rng.standard_normal((30, 3)), residual, 30, 1e-3)
    assert not step.any()
    assert not squares < np.inf


@pytest.mark.parametrize('side', [0, 1])
@pytest.mark.parametrize('width', [0.1, 0.2, 0.3])
def test_the_side_of_a_hysteresis_is_found(rng, width, side):
    """A step from that side may explain all: no search from there has to improve on it."""
    plant, T, N = plant_named('cylinder'), 0.01, 300
    model = Model(plant, {'tau': 0.05, 'K_v': 0.5}, T,
                  (place('hysteresis', 'command', {'width': width}, plant),))
    command = 0.2 + 0.05 * np.sin(2.0 * np.pi * T * np.arange(N))[:, None]
    follower = model.system.memory_edges(command[:1], np.zeros((1, plant.order)))[0, :, side]
    moved = model.system.run(command, np.zeros(plant.order), follower)
    part = Part(command, moved + 1e-4 * rng.standard_normal(N))
    found = initial_states(model, [part])
    assert found.z[0] == pytest.approx(follower, abs=0.02)
    assert found.rms[0] < 1.2e-4
