"""Runs with output feedback, against the theory of observers and differences of whole runs."""
from __future__ import annotations

from central_differences import differences
import numpy as np
import pytest
from scipy.linalg import expm

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.homotopy import RATIOS, steady_state_gain
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import coordinates_of, effect_unknowns, plant_unknowns
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.observer import process_root
from hydro_twin.predictors.sensitivities import OutputFeedback, run_with_sensitivities
from hydro_twin.predictors.tangents import NONE, tangent_of

SAMPLES = 60


def linear(name: str) -> Model:
    plant = PLANTS[name]
    return Model(plant, plant.constant_values() | plant.middle(), plant.sample_time)


def moved(model: Model) -> FloatArray:
    t = np.arange(SAMPLES) / SAMPLES
    return np.column_stack([0.1 * np.sin((5.0 + k) * t + 1.0)
                            for k in range(len(model.plant.inputs))])


def run(model: Model, inputs: FloatArray, x: FloatArray, feedback: OutputFeedback) -> FloatArray:
    system = model.system
    y, _ = run_with_sensitivities(system, NONE, [tangent_of(system, NONE)], inputs,
                                  np.array([0, len(inputs)]), x[None],
                                  np.zeros((1, system.memory)), feedback=feedback)
    return y[:, 0]


@pytest.mark.parametrize('name', PLANTS)
def test_an_error_of_the_start_decays_as_that_of_an_observer(name: str) -> None:
    """e(k+1) = Phi (I - K C) e(k), whatever the inputs, which a free run has without K."""
    model = linear(name)
    laws, inputs = model.system.laws, moved(model)
    n = len(laws.A)
    gain = steady_state_gain(model, 1.0)
    assert gain is not None
    truth = model.system.run(inputs, np.zeros(n))
    error = 1e-3 / np.maximum(np.abs(laws.C[0]), 1e-3 * np.abs(laws.C[0]).max())
    closed = expm(laws.A * model.sample_time) @ (np.eye(n) - np.outer(gain, laws.C))
    expected = [float(laws.C[0] @ np.linalg.matrix_power(closed, k) @ error)
                for k in range(SAMPLES)]
    found = run(model, inputs, error, OutputFeedback(truth, gain)) - truth
    np.testing.assert_allclose(found, expected, atol=1e-9 * abs(expected[0]), rtol=1e-6)


def test_a_sample_that_is_missing_corrects_nothing() -> None:
    model = linear('load_simulator')
    inputs, start = moved(model), np.array([0.0, 1e5, 0.0, 1e-3])
    gain = steady_state_gain(model, 1.0)
    assert gain is not None
    nothing = np.full(SAMPLES, np.nan)
    np.testing.assert_array_equal(run(model, inputs, start, OutputFeedback(nothing, gain)),
                                  model.system.run(inputs, start))


@pytest.mark.parametrize('effect', [
    ('stiffening', 'coupling', {'cubic': 100.0}),
    ('friction', 'motor', {'coulomb': 2.0, 'stribeck': 1.0, 'stribeck_velocity': 0.1}),
    ('delay', 'command', {'time': 0.0033})])
def test_derivatives_are_those_of_the_run_with_feedback(
        effect: tuple[str, str, dict[str, float]]) -> None:
    plant = PLANTS['load_simulator']
    bare = linear('load_simulator')
    model = Model(plant, bare.values, plant.sample_time, (place(*effect, plant),))
    inputs = moved(model)
    measured = bare.system.run(inputs, np.zeros(4)) + 0.1 * np.cos(np.arange(SAMPLES))
    gain = steady_state_gain(model, 1.0)
    assert gain is not None
    unknowns = [*plant_unknowns(plant, 'physical'), *effect_unknowns(0, model.effects[0])]
    problem = Problem(model, unknowns, [Part(inputs, measured)])
    feedback = OutputFeedback(measured, gain)
    expected, kinked = differences(
        lambda coordinates: run(problem.candidate(coordinates), inputs, np.zeros(4), feedback),
        coordinates_of(model, unknowns), [1e-5] * len(unknowns))
    system = model.system
    by, order = problem.directions(model)
    _, slopes = run_with_sensitivities(
        system, by, [tangent_of(system, by)], inputs, np.array([0, SAMPLES]), np.zeros((1, 4)),
        np.zeros((1, system.memory)), feedback=feedback)
    for column, k in enumerate(order):
        size = np.abs(expected[:, k]).max()
        smooth = kinked[:, k] < 1e-6 * size
        assert smooth.mean() > 0.5
        np.testing.assert_allclose(slopes[smooth, 0, column], expected[smooth, k],
                                   atol=1e-5 * size)


@pytest.mark.parametrize('ratio', RATIOS)
@pytest.mark.parametrize('name', PLANTS)
def test_the_gain_is_that_to_which_a_kalman_filter_converges(name: str, ratio: float) -> None:
    """By running the filter; its process noise moves the output by the ratio in a start-up."""
    model = linear(name)
    laws, T = model.system.laws, model.sample_time
    n, horizon = len(laws.A), model.plant.start_samples(T) * T
    rates = np.zeros(n)
    for k, row in enumerate(laws.E):
        if row.any():
            rates[k] = ratio / np.linalg.norm(laws.C @ process_root(laws, horizon, np.eye(n)[k]))
    root = process_root(laws, T, rates)
    Phi, C, covariance = expm(laws.A * T), laws.C[0], root @ root.T
    for _ in range(20_000):
        spread = covariance @ C
        gain = spread / (1.0 + C @ spread)
        covariance = Phi @ (covariance - np.outer(gain, spread)) @ Phi.T + root @ root.T
    np.testing.assert_allclose(steady_state_gain(model, ratio), gain, rtol=1e-6)
