"""Coefficients of populations against scipy's bilinear transform, plant by plant."""
from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.one_step import derivative
from hydro_twin.plants import Plant, PLANTS


def draw(plant: Plant, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low, high = np.array([(p.lower, p.upper) for p in plant.parameters]).T
    return np.exp(rng.uniform(np.log(low), np.log(high), (5, low.size)))


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_is_the_bilinear_transform(plant: Plant) -> None:
    constants, T = plant.constant_values(), plant.sample_time
    n, names = plant.order, [p.name for p in plant.parameters]
    population = draw(plant, 0)
    for values, found in zip(population, coefficients_of(plant, constants, T)(population),
                             strict=True):
        laws = plant.laws({**constants, **dict(zip(names, values, strict=True))})
        expected = []
        for column in range(len(plant.inputs)):
            b, a = signal.ss2tf(laws.A, laws.B, laws.C, laws.D, column)
            b, a = signal.bilinear(b[0], a, 1.0 / T)
            expected.append(np.r_[b, np.zeros(n + 1 - len(b))])
        np.testing.assert_allclose(found[:n], -a[1:], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(found[n:], np.concatenate(expected), rtol=1e-6,
                                   atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_takes_complex_parameters(plant: Plant) -> None:
    """The complex step against central differences."""
    coefficients = coefficients_of(plant, plant.constant_values(), plant.sample_time)
    at, step = draw(plant, 1)[0], 1e-5
    exact = derivative(coefficients, at)
    steps = np.exp(step * np.eye(at.size))
    central = (coefficients(at * steps) - coefficients(at / steps)).T / (2 * step)
    np.testing.assert_allclose(exact, central, rtol=1e-5, atol=1e-6 * np.abs(exact).max())
