"""The machines of the benchmark against scipy, and against what can be said on paper."""
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.tracing.machine_laws import (
    Axis,
    Cylinder,
    move_axis,
    move_cylinder,
    on_fine_steps,
    steady_speeds,
    STEP,
)
from benchmarks.tracing.machines import make_machine, outcome

CYLINDER = Cylinder(
    supply=1e7, area=2e-3, ratio=0.7, stroke=0.5, flow=2e-3 * 0.2 / math.sqrt(5e6),
    stiffness=8e8, dead_volume=1e-4, leakage=1e-12, spool=200.0, damping=0.8, mass=800.0,
    viscous=2e4, coulomb=0.0, load=2000.0)
AXIS = Axis(mass=20.0, viscous=40.0, coulomb=0.0, breakaway=1.2, fades=0.01, bias=10.0, lag=1e-3,
            end_mass=1.0, end_stiffness=0.0, end_damping=0.0)


def rates(t, s, c, u):
    """Write the cylinder again, for a valve that stays open one way."""
    x, v, opening, rate, p_1, p_2 = s
    a_1, a_2 = c.area, c.area * c.ratio
    drops = (c.supply - p_1, p_2) if opening > 0.0 else (p_1, c.supply - p_2)
    q_1, q_2 = (c.flow * opening * np.sign(drop) * abs(drop) ** 0.5 for drop in drops)
    lost = c.leakage * (p_1 - p_2)
    return (v, (p_1 * a_1 - p_2 * a_2 - c.load - c.viscous * v) / c.mass,
            rate, c.spool * (c.spool * (u - opening) - 2.0 * c.damping * rate),
            c.stiffness / (c.dead_volume + a_1 * x) * (q_1 - lost - a_1 * v),
            c.stiffness / (c.dead_volume + a_2 * (c.stroke - x)) * (lost + a_2 * v - q_2))


@pytest.mark.parametrize('u', [0.6, -0.4])
def test_the_cylinder_moves_as_scipy_has_it(u):
    c, seconds = CYLINDER, 0.8
    x, given = move_cylinder(c, 0.25, np.full(round(seconds / STEP), u), 0.0, 20)
    p_2 = 0.5 * c.supply
    start = (0.25, 0.0, 0.0, 0.0, (p_2 * c.area * c.ratio + c.load) / c.area, p_2)
    at = 20 * STEP * np.arange(len(x))
    other = solve_ivp(rates, (0.0, seconds), start, t_eval=at, args=(c, u), rtol=1e-8, atol=1e-9,
                      max_step=1e-3)
    np.testing.assert_allclose(x, other.y[0], atol=2e-3 * np.ptp(x))
    assert (given == u).all()


def test_the_cylinder_is_as_fast_as_its_pressures_allow():
    """Out and in, [Merritt 1967, 6.2]: the square of the flow is the drop of pressure."""
    c = CYLINDER._replace(viscous=0.0, leakage=0.0)
    c = c._replace(viscous=0.05 * c.mass * 2 * math.pi * 10)      # damps, and costs little
    for u, speed in zip((0.2, -0.2), steady_speeds(c), strict=True):
        x, _ = move_cylinder(c, 0.25, np.full(round(1.5 / STEP), u), 0.0, 20)
        found = (x[-1] - x[-250]) / (249 * 20 * STEP)
        assert found == pytest.approx(math.copysign(0.2 * speed, u), rel=0.03)


def test_ends_overlap_and_limits_of_the_cylinder():
    fast = np.full(round(4.0 / STEP), 1.0)
    x, _ = move_cylinder(CYLINDER, 0.25, fast, 0.0, 20)
    assert x.max() == pytest.approx(CYLINDER.stroke, abs=1e-3 * CYLINDER.stroke)
    closed = CYLINDER._replace(overlap_up=0.1, leakage=0.0)
    small, _ = move_cylinder(closed, 0.25, 0.09 * fast, 0.0, 20)
    assert np.ptp(small[500:]) < 1e-4
    limited, _ = move_cylinder(CYLINDER._replace(most=0.5), 0.25, fast[:10000], 0.0, 20)
    half, _ = move_cylinder(CYLINDER, 0.25, 0.5 * fast[:10000], 0.0, 20)
    assert limited[-1] - 0.25 == pytest.approx(half[-1] - 0.25, rel=0.03)


def test_the_axis_runs_up_against_its_damping_and_sticks_under_friction():
    nothing = np.zeros(round(2.0 / STEP))
    x, force = move_axis(AXIS, nothing, 0.0, 0.0, 1.0, 20)
    t, decay = 20 * STEP * np.arange(len(x)), AXIS.viscous / AXIS.mass
    expected = AXIS.bias / AXIS.viscous * (t + np.expm1(-decay * t) / decay)
    np.testing.assert_allclose(x, expected, atol=1e-4 * expected[-1])
    assert not force.any()
    stuck, _ = move_axis(AXIS._replace(coulomb=9.0), nothing, 0.0, 0.0, 1.0, 20)
    assert not stuck.any()                  # 10.8 N at rest, against 10 N


def test_values_are_held_or_joined_by_lines():
    held = on_fine_steps(np.array([0.0, 0.5]), np.array([1.0, 3.0]), 1.0, smooth=False)
    assert (held[0], held[round(0.499 / STEP)], held[-1]) == (1.0, 1.0, 3.0)
    joined = on_fine_steps(np.array([0.0, 0.5]), np.array([1.0, 3.0]), 1.0, smooth=True)
    assert joined[round(0.25 / STEP)] == pytest.approx(2.0)


@pytest.mark.parametrize('seed', [0, 1, 2, 2000, 2001])
def test_a_seed_is_a_machine(seed):
    one, other = make_machine(seed), make_machine(seed)
    assert make_machine(1_000_000 + seed).fields != one.fields
    for a, b in zip(one.series, other.series, strict=True):
        np.testing.assert_array_equal(a['x'], b['x'])
    assert len(one.recording().series) == 3


@pytest.mark.parametrize(('named', 'judged'), [
    (['friction', 'delay'], 'part'), (['friction', 'bias'], 'right'), (['dead_zone'], 'wrong'),
    (['delay'], 'none')])
def test_dynamics_that_the_plant_lacks_are_neither_right_nor_wrong(named, judged):
    line = {'effects': ['bias', 'friction'], 'also': ['delay'],
            'report': {'effects': [{'id': name} for name in named]}}
    assert outcome(line) == judged
