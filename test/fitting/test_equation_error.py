"""Starts of a search by the one-step error, for axes of any size and sensors that are held."""
import numpy as np
import pytest

from hydro_twin.fitting.equation_error import one_step_values
from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import Part
from hydro_twin.plants import plant_named

PLANT, T = plant_named('positioning'), 0.001


def axis(mass, friction, samples=6000):
    """M x'' + F_v x' = force, with a force that is held for some samples, solved exactly."""
    rng = np.random.default_rng(0)
    force = np.repeat(rng.standard_normal(samples // 40), 40) * 0.3 * mass
    x, v, position = 0.0, 0.0, np.empty(samples)
    decay = np.exp(-friction / mass * T)
    for k in range(samples):
        position[k] = x
        end = force[k] / friction
        x += end * T + (v - end) * (1.0 - decay) * mass / friction
        v = end + (v - end) * decay
    return force, position


@pytest.mark.parametrize('mass', [3e-3, 1.0, 400.0])
def test_an_axis_of_any_size_is_found(mass):
    force, position = axis(mass, 4.0 * mass)
    noise = 1e-4 * np.ptp(position) * np.random.default_rng(1).standard_normal(len(position))
    fit = fit_linear(PLANT, [Part(force[:, None], position + noise)], {}, T)
    assert fit.candidate.values['M'] == pytest.approx(mass, rel=0.02)
    assert fit.candidate.values['F_v'] == pytest.approx(4.0 * mass, rel=0.02)


def test_a_position_that_is_held_is_read_over_longer_steps():
    """As of a drive that answers every 15 ms and is logged every millisecond."""
    force, position = axis(1.2, 0.5)
    held = np.repeat(position[::15], 15)
    found = one_step_values(PLANT, [Part(force[:, None], held)], {}, T)
    assert max(found[0]['M'], 1.2) / min(found[0]['M'], 1.2) > 5.0
    assert any(values['M'] == pytest.approx(1.2, rel=0.15) for values in found)


def test_fits_that_say_the_same_are_one():
    force, position = axis(1.2, 0.5)
    assert len(one_step_values(PLANT, [Part(force[:, None], position)], {}, T)) == 1
