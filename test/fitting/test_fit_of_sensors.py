"""Fits with sensors beside the output, each weighed by its own noise."""
from dataclasses import replace

import numpy as np
import pytest

from hydro_twin.fitting.output_error import fitted_residuals
from hydro_twin.fitting.outputs import sensors_in
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import plant_unknowns
from hydro_twin.model import Model
from hydro_twin.plants import PLANTS

PLANT = PLANTS['load_simulator']
TRUTH = {**PLANT.constant_values(), **PLANT.middle(), 'K_q': 1.1, 'J': 0.05}
NOISE = {'T_g': 0.5, 'p_L': 3e4, 'x_v': 1.5e-7}
FAILS = 400


def recorded(seed=0, samples=900, noise=NOISE):
    """Run the true plant, with noise on output and sensors; the pressure fails half-way."""
    rng = np.random.default_rng(seed)
    t = 0.002 * np.arange(samples)
    inputs = np.column_stack([
        0.3 * np.sin(2 * np.pi * 7 * t) * np.sin(2 * t) + 0.1 * np.sin(2 * np.pi * 23 * t),
        0.02 * np.sin(2 * np.pi * 1.3 * t) + 0.004 * np.sin(2 * np.pi * 11 * t)])
    system = Model(PLANT, TRUTH, 0.002).system
    seen = np.empty((samples, len(system.step.H)))
    y = system.run(inputs, np.zeros(PLANT.order), seen=seen)
    column = dict(zip((s.name for s in PLANT.sensors), seen[:, system.step.sensors:].T,
                      strict=True)) | {'T_g': y}
    measured = {name: column[name] + rms * rng.standard_normal(samples)
                for name, rms in noise.items()}
    measured.get('p_L', y)[FAILS:] = np.nan
    return Part(inputs, measured.pop('T_g'), sensors=measured)


def fitted(part):
    plant = PLANT.seen_by(sensors_in([part], PLANT, 50))
    start = Model(plant, {**TRUTH, **PLANT.middle()}, 0.002)
    return Problem(start, plant_unknowns(plant, 'physical'), [part]).solve()


@pytest.fixture(scope='module')
def part():
    return recorded()


@pytest.fixture(scope='module')
def fit(part):
    return fitted(part)


def test_the_noise_of_each_is_estimated_with_the_fit(fit):
    assert fit.noise == pytest.approx(NOISE, rel=0.08)
    assert fit.error == pytest.approx(fit.noise['T_g'])
    scored = 900 - fit.candidate.start_up
    assert fit.lengths == (scored, FAILS - fit.candidate.start_up, scored)
    # All weigh alike: each piece has the mean square of the whole.
    pieces = np.split(fit.residual, np.cumsum(fit.lengths)[:-1])
    assert [np.mean(piece**2) for piece in pieces] == pytest.approx([np.mean(fit.residual**2)] * 3)


def test_the_spool_parts_the_gains_and_values_are_true_within_their_errors(fit):
    known = fit.identifiability()
    for name in ('J', 'K_p', 'K_q', 'G', 'K_ce', 'B_m', 'K_sv'):
        error = known.std_error[name]
        assert error is not None, name
        assert abs(np.log(fit.candidate.values[name] / TRUTH[name])) < 4.0 * error
    assert known.std_error['K_q'] < 0.005
    alone = fitted(recorded(noise={'T_g': NOISE['T_g']}))
    assert 'K_sv' not in alone.identifiability().std_error      # K_q stands for both
    assert known.std_error['J'] < 0.6 * alone.identifiability().std_error['J']


def test_the_end_is_the_maximum_of_the_concentrated_likelihood(part, fit):
    """By its definition, from the runs: no parameter of one per mille more or less is likelier."""
    def loss(candidate):
        seen = np.empty((len(part.inputs), len(candidate.system.step.H)))
        y = candidate.system.run(part.inputs, np.zeros(PLANT.order), seen=seen)
        rows = dict(zip(('p_L', 'x_v'), seen[:, candidate.system.sensor_rows(['p_L', 'x_v'])].T,
                        strict=True))
        total = 0.0
        for measured, run in ((part.measured, y),
                              *((part.sensors[name], rows[name]) for name in rows)):
            left = (measured - run)[candidate.start_up:]
            left = left[np.isfinite(left)]
            total += len(left) * np.log(np.mean(left**2))
        return total

    best = loss(fit.candidate)
    for name in ('G', 'K_p', 'K_sv', 'K_q', 'K_ce', 'B_m', 'J'):
        for factor in (0.98, 1.02):
            moved = {**fit.candidate.values, name: factor * fit.candidate.values[name]}
            assert loss(replace(fit.candidate, values=moved)) > best, name


def test_costs_compare_as_likelihoods_do(part, fit):
    """N ln of the mean square of two fits differs as the sum of N_q ln sigma_q^2 does."""
    unknown = [u for u in fit.unknowns if u.name == 'G']
    moved = replace(fit.candidate, values={**fit.candidate.values, 'J': 0.06})
    other = Problem(moved, unknown, [part]).solve()
    counts = dict(zip(('T_g', 'p_L', 'x_v'), fit.lengths, strict=True))
    likelihoods = [sum(n * np.log(one.noise[name]**2) for name, n in counts.items())
                   for one in (fit, other)]
    n = len(fit.residual)
    assert likelihoods[1] > likelihoods[0] + 10.0
    assert n * np.log(np.mean(other.residual**2) / np.mean(fit.residual**2)) == pytest.approx(
        likelihoods[1] - likelihoods[0], rel=1e-9)


def test_a_sensor_that_only_makes_noise_changes_nothing():
    loud = recorded(noise={'T_g': NOISE['T_g'], 'x_v': 1.0})
    one, both = fitted(replace(loud, sensors={})), fitted(loud)
    for name in ('G', 'K_p', 'K_ce', 'B_m'):
        assert both.candidate.values[name] == pytest.approx(one.candidate.values[name], rel=1e-3)


def test_the_main_output_stands_alone_in_its_unit(part, fit):
    main = fit.main
    assert main.sensors == ()
    assert len(main.residual) == len(main.jacobian) == 900 - fit.candidate.start_up
    assert main.residual == pytest.approx(
        fitted_residuals(fit.candidate, [part])[0], abs=0.1 * NOISE['T_g'])


@pytest.mark.parametrize(('sensors', 'combinations'), [
    ((), ['V_m', 'K_q']), (('p_L',), ['V_m', 'K_q']), (('x_v',), ['V_m']),
    (('theta_m', 'omega_m'), ['V_m', 'K_q']), (('p_L', 'x_v'), ['V_m'])])
def test_sensors_part_combinations(sensors, combinations):
    assert [next(iter(c)) for c in PLANT.seen_by(sensors).combinations] == combinations


def test_the_servomotor_parts_nothing():
    plant = PLANTS['valve_servo']
    assert plant.seen_by(['servomotor']) is plant
