"""Parameters that are followed: a friction that doubles, and what cannot be followed."""
from dataclasses import replace
import math

import numpy as np
import pytest

from hydro_twin.errors import ModelError
from hydro_twin.model import Model, Noise, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors import kernel
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.follow import parse, RATE

LOAD = PLANTS['load_simulator']
T = LOAD.sample_time
COULOMB = 'friction@motor:coulomb'
MODEL = Model(LOAD, LOAD.constant_values() | LOAD.middle(), T,
              (place('friction', 'motor', {'coulomb': 10.0}, LOAD),),
              noise=Noise(0.5, {'x_v': 1e-6}, dict.fromkeys(LOAD.states, 0.0)))


def following(**rates):
    return Analytical(replace(MODEL, noise=replace(MODEL.noise, follow=rates)))


def with_factor(name, factor):
    if name == COULOMB:
        return replace(MODEL, effects=(
            place('friction', 'motor', {'coulomb': 10.0 * factor}, LOAD),))
    return replace(MODEL, values={**MODEL.values, name: MODEL.values[name] * factor})


def warming(name, seconds, rng):
    """Simulate a parameter that doubles within a minute, in steps of half a second."""
    samples, every = round(seconds / T), 250
    t = T * np.arange(samples)
    inputs = np.column_stack([
        0.5 * sum(np.sin(2 * np.pi * f * t + f) for f in (0.7, 2.3, 6.1)),
        0.02 * np.sin(2 * np.pi * 1.3 * t)])
    factor = 1.0 + t / 60.0
    x, z, y = np.zeros(4), np.zeros(MODEL.system.memory), np.empty(samples)
    for first in range(0, samples, every):
        system = with_factor(name, factor[first]).system
        kernel.run(system.step, x, z, system.work(), inputs, y, np.empty((0, 0)), first,
                   min(first + every, samples))
    return inputs, y + 0.5 * rng.standard_normal(samples), factor


@pytest.mark.parametrize('name', ['B_m', COULOMB])
def test_a_friction_that_doubles_within_a_minute_is_followed(name):
    inputs, measured, factor = warming(name, 60.0, np.random.default_rng(1))
    observer = following(**{name: RATE}).filter
    results, estimates = observer.run(inputs, measured, estimates=True)
    values, errors = np.moveaxis(estimates[:, :, -1], 1, 0)
    missed = np.exp(values - np.log(factor)) - 1.0
    settled = slice(round(10.0 / T), None)
    assert np.abs(missed[settled]).max() < 0.15
    assert np.mean(np.abs(values - np.log(factor))[settled] < 1.96 * errors[settled]) > 0.9
    innovation = (measured - results[:, 0])[settled] / np.sqrt(results[settled, 1])
    assert innovation.std() == pytest.approx(1.0, abs=0.05)


def test_live_it_is_followed_as_offline_to_the_last_digit():
    inputs, measured, _ = warming('B_m', 12.0, np.random.default_rng(2))
    measured[2000:2100] = math.nan
    predictor = following(B_m=0.3)
    results, estimates = predictor.filter.run(inputs, measured, estimates=True)
    assert np.abs(estimates[:, 0, -1]).max() > 0.1          # matrices were made anew
    stepper = predictor.stepper('observer')
    for k in range(len(inputs)):
        assert stepper.step(inputs[k], measured[k]) == results[k, 0]
        value, error = stepper.parameters[:, 0]
        assert value == MODEL.values['B_m'] * np.exp(estimates[k, 0, -1])
        assert error == value * estimates[k, 1, -1]
    known, later = stepper.ahead(50), stepper.ahead(50)
    assert known == later                                   # which leaves the run as it is


def test_a_parameter_that_stays_is_believed_ever_more():
    inputs, measured, _ = warming('B_m', 0.2, np.random.default_rng(3))
    rest = following(B_m=1e-9).filter.run(inputs, measured, estimates=True)[1][:, 1, -1]
    assert rest[-1] < rest[0]


@pytest.mark.parametrize('name', ['friction', 'K_x', 'friction@motor:stribeck'])
def test_what_the_model_lacks_cannot_be_followed(name):
    with pytest.raises(ModelError, match=f'no parameter {name} to follow; it has V_m, J'):
        following(**{name: 0.1}).stepper('observer')


def test_rates_are_read():
    assert parse(['B_m', 'G=0.2', '']) == {'B_m': RATE, 'G': 0.2}
    for wrong in ('B_m=fast', 'B_m=0', 'B_m=-1', 'B_m=nan'):
        with pytest.raises(ModelError, match='must be a positive number'):
            parse([wrong])
