"""Derivatives of a run, against differences of whole runs and against another integrator."""
from __future__ import annotations

import itertools
from itertools import pairwise

from central_differences import differences
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from hydro_twin.effects import EFFECTS, Placed, sites
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import effect_unknowns, get, plant_unknowns, timing_unknowns
from hydro_twin.inference.screen import spans
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.sensitivities import run_with_sensitivities
from hydro_twin.predictors.system import assemble, HOLD, LINEAR
from hydro_twin.predictors.tangents import Directions, tangent_of, tangents_of

SAMPLES = 120
EVERYWHERE = [(plant, effect, port) for plant in PLANTS.values() for effect in EFFECTS
              for port in sites(effect, plant) if effect.course is None]


def middle(plant):
    return plant.constant_values() | {p.name: (p.lower * p.upper) ** 0.5 for p in plant.parameters}


def moved(plant):
    """Move the inputs of a plant so that its output swings."""
    rng = np.random.default_rng(1)
    t = plant.sample_time * np.arange(SAMPLES)
    scale = {'u_m': 0.1, 'theta_d': 0.02, 'force': 300.0, 'torque': 5.0}
    return np.column_stack([
        scale.get(signal.name, 0.5) * sum(
            np.sin(2 * np.pi * f / (SAMPLES * plant.sample_time) * t + rng.uniform(0, 6))
            for f in (1.3, 3.7)) for signal in plant.inputs])


def with_effect(plant, effect=None, port=None):
    """Put a plant in the middle of its box in motion, with an effect that does something."""
    linear = Model(plant, middle(plant), plant.sample_time,
                   timing={s.name: -0.3 * plant.sample_time for s in plant.inputs if s.held},
                   interpolation=LINEAR if effect is None else HOLD)
    inputs = moved(plant)
    part = Part(inputs, linear.system.run(inputs, np.zeros(plant.order)))
    if effect is None:
        return linear, part
    reach = spans(linear, [part])[port]
    starts = [values for values in effect.starts(reach) if all(
        p.lower <= v <= p.upper for p, v in zip(effect.parameters, values, strict=True))]
    values = starts[len(starts) // 2]
    if effect.refined is not None:          # all of the law, not only its simple form
        values = next(iter(effect.refined(reach, tuple(values))), values)
    if effect.shifts:                       # by no whole number of samples, where there is a kink
        values = (2.7 * plant.sample_time,)
    timing = {} if effect.shifts else linear.timing
    return Model(plant, linear.values, plant.sample_time,
                 (Placed(effect, port, tuple(map(float, values))),), timing, substeps=2), part


def states_of(candidate, part):
    """Run by the linear laws and return the states, (N, n)."""
    laws, T = candidate.system.laws, candidate.sample_time
    step, x, states = expm(laws.A * T), np.zeros(len(laws.A)), []
    for u in part.inputs:
        x = step @ x + T * laws.B @ u
        states.append(x)
    return np.array(states)


def unknowns_of(candidate):
    unknowns = plant_unknowns(candidate.plant, 'physical')
    unknowns += timing_unknowns(candidate) if candidate.timing else []
    for index, placed in enumerate(candidate.effects):
        unknowns += effect_unknowns(index, placed)
    return unknowns


def of_one_part(system, by, tangents, inputs, x, z, start=None, sensors=()):
    """Run over one part; returns output and sensors, and their derivatives."""
    y, slopes = run_with_sensitivities(
        system, by, tangents, inputs, np.array([0, len(inputs)]), x[None], z[None], [start],
        sensors)
    return y.T, slopes.transpose(1, 0, 2)


@pytest.mark.parametrize(
    ('plant', 'effect', 'port'), [(plant, None, None) for plant in PLANTS.values()] + EVERYWHERE,
    ids=lambda x: getattr(x, 'id', getattr(x, 'name', 'none')))
def test_all_derivatives_of_a_run(plant, effect, port):
    """By the plant's and the effect's parameters, timing, and the state at the start."""
    candidate, part = with_effect(plant, effect, port)
    problem = Problem(candidate, unknowns_of(candidate), [part])
    by, order = problem.directions(candidate)
    system = candidate.system
    x = 1e-3 * np.max(np.abs(states_of(candidate, part)), axis=0)
    z = np.zeros(system.memory)
    sensors = [sensor.name for sensor in plant.sensors]
    every, slopes = of_one_part(system, by, [tangent_of(system, by)], part.inputs, x, z, None,
                                sensors)
    y, scale = every[0], np.std(every[0]) / np.maximum(np.std(every, axis=1), 1e-300)
    np.testing.assert_array_equal(y, system.run(part.inputs, x, z))
    # Without sensors, what effects add is left out at a sample where it does not reach the output.
    alone = of_one_part(system, by, [tangent_of(system, by)], part.inputs, x, z)
    np.testing.assert_array_equal(alone[0], every[:1])
    np.testing.assert_array_equal(alone[1], slopes[:1])
    slopes = np.concatenate(scale[:, None, None] * slopes)

    def run(coordinates):
        moved = problem.candidate(coordinates[:by.count]).system
        seen = np.empty((len(y), len(moved.step.H)))
        output = moved.run(part.inputs, x + coordinates[by.count:], z, seen)
        return np.concatenate(scale[:, None] * np.vstack([output, seen[:, moved.step.sensors:].T]))

    at = np.concatenate([[u.coordinate(get(candidate, u)) for u in problem.unknowns],
                         np.zeros(plant.order)])
    states = np.std(y) / np.maximum(
        np.abs(slopes[:, by.count:by.count + plant.order]).max(axis=0), 1e-300)
    expected, kinked = differences(run, at, np.concatenate([
        np.full(by.count, 1e-5), 1e-5 * states]))
    found = np.empty(expected.shape)
    found[:, order] = slopes[:, :by.count]
    found[:, by.count:] = slopes[:, by.count:by.count + plant.order]
    size = np.abs(expected).max(axis=0) + 1e-9 * np.std(y) / np.concatenate([
        np.ones(by.count), states])
    # Near a kink the two steps may agree by chance: with more outputs more of that is seen.
    smooth = kinked < np.repeat([1e-6] + [3e-7] * len(sensors), len(y))[:, None] * size
    assert smooth.mean() > 0.5
    assert (np.abs(found - expected) / size)[smooth].max() < 1e-6


def test_by_an_inertia_and_a_lag_as_the_variational_equation_has_it():
    """D x / d ln J, integrated by scipy beside x: J only divides one row of the laws."""
    plant = PLANTS['load_simulator']
    values = middle(plant)
    system, inputs = assemble(plant, values), moved(plant)
    laws = system.laws
    states, T = len(laws.A), system.step.sample_time
    held = [signal.held for signal in plant.inputs]
    by = Directions([('J', values['J']), ('K_p', values['K_p'])])
    _, (slopes,) = of_one_part(system, by, [tangent_of(system, by)], inputs, np.zeros(states),
                               np.zeros(0))
    rows = [plant.states.index('omega_j'), plant.states.index('x_v')]

    def rates(s, both, u0, u1):
        v = np.where(held, u0, u0 + s / T * (u1 - u0))
        x, *moves = both.reshape(3, states)
        rate = laws.A @ x + laws.B @ v
        return np.concatenate([rate, *(
            laws.A @ dx - np.where(np.arange(states) == row, rate, 0.0)
            for dx, row in zip(moves, rows, strict=True))])

    both, expected = np.zeros(3 * states), [np.zeros(2)]
    for u0, u1 in itertools.pairwise(inputs):
        both = solve_ivp(rates, (0.0, T), both, 'DOP853', args=(u0, u1), rtol=1e-10,
                         atol=[1e-16, 1e-4, 1e-10, 1e-13] * 3).y[:, -1]
        expected.append(both.reshape(3, states)[1:] @ laws.C[0])
    expected = np.array(expected)
    np.testing.assert_allclose(slopes[:, :2], expected, atol=1e-7 * np.abs(expected).max())


def test_derivatives_that_grow_without_bound_are_left_out():
    """As at rest, under laws that are not stable: the run is bounded, its derivatives are not."""
    plant = PLANTS['load_simulator']
    values = middle(plant) | {'B_m': -50.0, 'J': 0.01}
    system, inputs = assemble(plant, values), np.zeros((SAMPLES, 2))
    by = Directions([('K_q', 1.0)])
    y, slopes = of_one_part(system, by, [tangent_of(system, by)], inputs, np.zeros(plant.order),
                            np.zeros(0))
    assert not y.any()
    assert not slopes.any()


@pytest.mark.parametrize('effects', [
    [('friction', 'motor', {'coulomb': 5.0})],
    [('backlash', 'coupling', {'gap': 1e-3})],
    [('drift', 'K_q', {'rate': -0.5, 'begin': 0.0, 'end': 0.6})]])
def test_parts_run_together_as_each_by_itself(effects):
    """Parts of any length, one of which diverges, and which begin at any stage of a drift."""
    plant = PLANTS['load_simulator']
    system = Model(plant, middle(plant), plant.sample_time,
                   tuple(place(*effect, plant) for effect in effects)).system
    by = Directions([('J', middle(plant)['J'])])
    tangents = tangents_of(system, by)
    inputs = [moved(plant)[:80], 1e30 * moved(plant)[:50], moved(plant)]
    rng = np.random.default_rng(2)
    x = 1e-3 * rng.standard_normal((len(inputs), plant.order))
    z = 1e-4 * rng.standard_normal((len(inputs), system.memory))
    starts, edges = [0, 300_000_000, None], np.cumsum([0, *map(len, inputs)])
    together = run_with_sensitivities(system, by, tangents, np.concatenate(inputs), edges, x, z,
                                      starts, ['p_L'])
    plain = system.run_parts(np.concatenate(inputs), edges, x, z, starts)
    for k, (begin, end) in enumerate(pairwise(edges)):
        y, slopes = (some[begin:end] for some in together)
        alone = of_one_part(system, by, tangents, inputs[k], x[k], z[k], starts[k], ['p_L'])
        np.testing.assert_array_equal(y.T, alone[0])
        np.testing.assert_array_equal(slopes.transpose(1, 0, 2), alone[1])
        np.testing.assert_array_equal(plain[begin:end], system.run(
            inputs[k], x[k], z[k], start=starts[k]))
    assert np.isnan(together[0][edges[2] - 1, 0])
    assert np.isfinite(together[0][edges[2]:]).all()
