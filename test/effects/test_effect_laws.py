"""The law of each effect against its definition, written down a second time."""
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from hydro_twin.effects import EFFECTS
from hydro_twin.model import place
from hydro_twin.plants import PLANTS

AT = {(effect.id, effect.kinds[0]): effect for effect in EFFECTS}
V = np.linspace(-2.0, 2.0, 41)
INF = math.inf
number = st.floats(-10.0, 10.0)
above = st.floats(1e-3, 10.0)


def law(key):
    return AT[key].law


def apply(key, v, parameters, signals=()):
    """Evaluate a law, one value after another, before it remembers any."""
    signals = [np.broadcast_to(s, np.shape(v)) for s in signals]
    return np.array([
        law(key)(value, np.array([*(s[k] for s in signals), 0.0]), np.array(parameters),
                 np.zeros(AT[key].memory), 1e-3, 0.0, np.zeros(AT[key].memory))
        for k, value in enumerate(v)])


def remember(key, v, parameters, step=1e-3):
    """Evaluate a law with memory along a sequence."""
    z, out = np.zeros(AT[key].memory), []
    for value in v:
        z_next = z.copy()
        out.append(law(key)(value, np.zeros(2), np.array(parameters), z, step, 0.0, z_next))
        z = z_next
    return np.array(out)


def test_asymmetry_is_two_slopes():
    expected = np.where(V > 0, 1.3 * V, 0.7 * V)
    np.testing.assert_allclose(apply(('asymmetry', 'flow'), V, [0.3]), expected, atol=1e-15)


def test_backlash_leaves_the_twist_beyond_the_gap():
    stiffness, gap = 9e3, 0.4
    expected = stiffness * (V - np.clip(V, -gap, gap))
    found = apply(('backlash', 'coupling'), stiffness * V, [gap], [V])
    np.testing.assert_allclose(found, expected, atol=1e-11)


def test_bias_adds():
    np.testing.assert_allclose(apply(('bias', 'command'), V, [0.25]), V + 0.25)


def test_dead_zone_passes_what_exceeds_it():
    width, centre = 0.5, 0.2
    w = V - centre
    expected = np.sign(w) * np.maximum(np.abs(w) - width, 0.0)
    found = apply(('dead_zone', 'opening'), V, [width, centre, 0.0])
    np.testing.assert_allclose(found, expected, atol=1e-15)


@pytest.mark.parametrize('port', ['linkage', 'stem'])
def test_behind_an_actuator_nothing_comes_until_it_has_moved_past_the_dead_zone(port):
    l_1, l_2 = 0.7, 0.1             # [L18] figure 1, opening and closing
    expected = np.where(l_1 < V, V - l_1, np.where(-l_2 > V, V + l_2, 0.0))
    effect = place('dead_zone', port, {'width': 1.0}, PLANTS['valve_servo']).effect
    assert effect.law is law(('dead_zone', 'opening'))
    found = apply(('dead_zone', 'opening'), V, [(l_1 + l_2) / 2, (l_1 - l_2) / 2, 0.0])
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_dead_zone_that_leaks_has_its_slope_within_and_no_jump():
    width, leak = 0.5, 0.3
    found = apply(('dead_zone', 'opening'), V, [width, 0.0, leak])
    sealed = np.sign(V) * np.maximum(np.abs(V) - width, 0.0)
    through = np.interp(V, [-width, width], [-leak * width, leak * width])
    np.testing.assert_allclose(found, sealed + through, atol=1e-15)


def test_gain_never_turns_round():
    found = apply(('gain', 'speed'), np.ones_like(V), [0.8], [V])
    np.testing.assert_allclose(found, np.clip(1 + 0.8 * V, 0, None))


def test_leakage_is_odd_and_a_power_of_the_pressure():
    p = np.linspace(-8e6, 8e6, 33)
    for exponent in (0.5, 2.0):
        expected = 0.1 + 3e-7 * np.sign(p) * np.abs(p / 1e6) ** exponent
        found = apply(('leakage', 'leakage'), np.full_like(p, 0.1), [3e-7, exponent], [p])
        np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_orifice_is_the_square_root_of_the_drop():
    x, p = (a.ravel() for a in np.meshgrid(V, np.linspace(-12e6, 12e6, 25)))
    supply = 10e6
    with np.errstate(invalid='ignore'):
        expected = 1.35 * x * np.nan_to_num(np.sqrt((supply - np.sign(x) * p) / supply))
    found = apply(('orifice', 'flow'), 1.35 * x, [supply], [x, p])
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_a_speed_through_an_orifice_is_that_at_which_flow_and_load_agree():
    """Of the valve and of the load, found by a search for where they meet."""
    up, down, asked = 0.5, 0.3, 0.5 * V

    def meets(v, v_l):
        return brentq(lambda y: v * np.sqrt(1 - y / v_l) - y, 0.0, v_l)

    expected = [meets(v, up) if v > 0 else -meets(-v, down) for v in asked]
    found = apply(('orifice', 'speed'), asked, [0.4, 0.25, 0.0, 0.0], [asked, 0.0 * asked])
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert -down < found.min() < found.max() < up


def test_a_mass_on_oil_behind_an_orifice_moves_as_its_equations_say():
    """As scipy integrates them, with an error that falls with the square of the step."""
    def asked(t):
        return 0.3 * math.sin(2.0 * t) + 0.15 * math.tanh(5.0 * math.sin(4.0 * t))

    v_l, imbalance, inertia, compliance = 0.8, 0.2, 0.12, 0.004

    def rates(t, state):
        y, P = state
        drop = 1.0 - P / (1.0 + imbalance if asked(t) > 0 else imbalance - 1.0)
        flow = asked(t) * math.copysign(math.sqrt(abs(drop)), drop)
        return [(P - y / v_l) / inertia, (flow - y) / compliance]

    exact = solve_ivp(rates, (0.0, 3.0), [0.0, 0.0], 'LSODA', rtol=1e-9, atol=1e-11,
                      max_step=1e-3, dense_output=True).sol
    errors = []
    for step in (0.01, 0.005, 0.0025):
        times = step * np.arange(round(3.0 / step) + 1)
        found = remember(('orifice', 'speed'), [asked(t) for t in times],
                         [v_l, imbalance, inertia, compliance], step)
        errors.append(np.abs(found - exact(times)[0]).max())
    assert errors[0] < 0.01 * 0.45
    np.testing.assert_allclose(errors[:-1] / np.array(errors[1:]), 4.0, rtol=0.1)


@pytest.mark.parametrize('asked', [-0.5, 0.2])
def test_a_mass_behind_an_orifice_ends_at_the_steady_speed(asked):
    parameters = [0.4, 0.25, 0.1, 0.003]
    found = remember(('orifice', 'speed'), [0.0, *np.full(5000, asked)], parameters)
    steady = apply(('orifice', 'speed'), [asked], [*parameters[:2], 0.0, 0.0], [asked, 0.0])
    np.testing.assert_allclose(found[-1], steady[0], rtol=1e-9)
    assert abs(found[1] - steady[0]) > 0.01


@pytest.mark.parametrize('key', [('rate_limit', 'rate'), ('saturation', 'opening')])
def test_limits_are_limits(key):
    limits = [0.7, 0.0, 0.0] if key[0] == 'rate_limit' else [-0.7, 0.7, 0.0]
    np.testing.assert_array_equal(apply(key, V, limits), np.clip(V, -0.7, 0.7))


def test_rates_may_differ_up_and_down():
    np.testing.assert_allclose(apply(('rate_limit', 'rate'), V, [1.0, -0.7, 0.0]),
                               np.clip(V, -1.7, 0.3), rtol=1e-15)


def test_a_soft_rate_limit_is_nearly_the_hyperbolic_tangent():
    limit = np.where(V > 0, 0.5, 0.7)
    found = apply(('rate_limit', 'rate'), V, [0.6, -1 / 6, 0.37])
    np.testing.assert_allclose(found, limit * np.tanh(V / limit), atol=0.0201 * 0.7)
    nearly_hard = apply(('rate_limit', 'rate'), V, [0.6, 0.0, 0.021])
    np.testing.assert_allclose(nearly_hard, np.clip(V, -0.6, 0.6), atol=0.02)


def test_a_soft_saturation_is_nearly_the_hyperbolic_tangent():
    limit = np.where(V > 0, 0.5, 0.7)
    found = apply(('saturation', 'opening'), V, [-0.7, 0.5, 0.37])
    np.testing.assert_allclose(found, limit * np.tanh(V / limit), atol=0.0201 * 0.7)
    one_end = apply(('saturation', 'opening'), V, [-INF, 0.5, 0.37])
    np.testing.assert_allclose(one_end, np.where(V > 0, found, V), rtol=1e-12)


def test_a_range_to_one_side_of_zero_has_corners():
    np.testing.assert_array_equal(apply(('saturation', 'opening'), V, [0.2, 0.8, 0.37]),
                                  np.clip(V, 0.2, 0.8))


def test_saturation_may_have_one_end():
    np.testing.assert_array_equal(apply(('saturation', 'opening'), V, [-INF, 1.05, 0.0]),
                                  np.minimum(V, 1.05))


def test_ripple_is_a_wave_with_a_phase():
    cosine, sine = 3.0, -2.0
    expected = math.hypot(cosine, sine) * np.cos(9 * V - math.atan2(sine, cosine))
    found = apply(('ripple', 'force'), np.zeros_like(V), [cosine, sine, 9.0, *[0.0] * 4], [V])
    np.testing.assert_allclose(found, expected, atol=1e-13)


def test_ripple_with_harmonics_is_a_fourier_series():
    amplitudes = np.array([0.0, 3.0 - 2.0j, -1.0 + 0.5j, 0.25j])
    turn = np.arange(64) / 64 * 2 * np.pi / 9.0
    expected = np.fft.irfft(np.conj(amplitudes) / 2, 64) * 64
    parameters = [amplitudes[1].real, amplitudes[1].imag, 9.0,
                  *(part for a in amplitudes[2:] for part in (a.real, a.imag))]
    found = apply(('ripple', 'force'), np.zeros(64), parameters, [turn])
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(('stage', 'begins'), [(0.0, 1.0), (1.5, 0.4321)])
def test_stiffening_is_the_slope_of_the_energy_of_a_cubic_spring_and_one_behind_a_gap(
        stage, begins):
    stiffness, cubic, step = 2.0, 0.6, 1e-5

    def energy(twist):
        met = np.maximum(np.abs(twist) - begins, 0.0)
        return stiffness * (twist**2 / 2 + cubic * twist**4 / 4 + stage * met**2 / 2)

    expected = (energy(V + step) - energy(V - step)) / (2 * step)
    found = apply(('stiffening', 'coupling'), stiffness * V, [cubic, stage, begins], [V])
    np.testing.assert_allclose(found, expected, atol=1e-8)


def play(values, half_width):
    """Move a loose sleeve round a rod: it is pushed at either end, and else stays."""
    sleeve, out = 0.0, []
    for rod in values:
        if rod - sleeve > half_width:
            sleeve = rod - half_width
        elif sleeve - rod > half_width:
            sleeve = rod + half_width
        out.append(sleeve)
    return np.array(out)


@given(st.lists(number, min_size=1, max_size=40), above)
def test_play_is_a_sleeve_on_a_rod(values, gap):
    np.testing.assert_allclose(remember(('backlash', 'stem'), values, [gap]),
                               play(values, gap), atol=1e-12)


@given(st.lists(number, min_size=1, max_size=40), above, st.floats(0.02, 1.0))
def test_hysteresis_is_play_on_the_part_that_is_bound(values, width, slope):
    v = np.array(values)
    expected = (1 - slope) * v + play(slope * v, width)
    np.testing.assert_allclose(remember(('hysteresis', 'command'), v, [width, slope]),
                               expected, atol=1e-12)


@given(st.lists(number, min_size=2, max_size=30), st.integers(1, 5))
def test_hysteresis_does_not_know_time(values, times):
    """Values visited slowly, in many small steps, leave the same loop."""
    slow = np.interp(np.arange((len(values) - 1) * times + 1) / times, np.arange(len(values)),
                     values)
    key, parameters = ('hysteresis', 'command'), [1.0, 0.7]
    start = remember(key, np.array(values), parameters)
    again = remember(key, np.concatenate([values[:1], slow[1:]]), parameters)
    np.testing.assert_allclose(again[::times], start, atol=1e-12)


def rub(free, compliance, parameters, z=0.0, h=5e-4):
    """Friction at the end of a step from rest: its force, and the bending of the bristles."""
    friction = AT['friction', 'force']
    memory = np.zeros(friction.memory)
    memory[0] = z
    z_next = memory.copy()
    force = -friction.law(0.0, np.array([free, 0.0]), np.array(parameters), memory, h, compliance,
                          z_next)
    return force, z_next[0]


coulomb_and_stribeck = st.tuples(above, st.floats(0.0, 10.0), above, st.just(INF), st.just(0.0))
bristles = st.tuples(above, st.floats(0.0, 10.0), above, st.floats(1.0, 1e7), st.just(0.0))


@given(number, above, coulomb_and_stribeck)
def test_friction_takes_energy_or_holds_still(free, compliance, parameters):
    force, _ = rub(free, compliance, parameters)
    velocity = free - compliance * force
    assert force * velocity >= -1e-9
    assert abs(force) <= (parameters[0] + parameters[1]) * (1 + 1e-12)
    if abs(free) < compliance * parameters[0]:
        assert abs(velocity) < 1e-12


@given(number, above, above)
def test_sliding_friction_is_coulombs(free, compliance, sliding):
    force, _ = rub(free, compliance, (sliding, 0.0, 1.0, INF, 0.0))
    expected = np.sign(free) * min(sliding, abs(free) / compliance)
    assert force == pytest.approx(expected, rel=1e-12)


def test_breakaway_is_gone_at_high_speed():
    parameters = (2.0, 3.0, 0.1, INF, 0.0)
    assert rub(10.0, 1e-6, parameters)[0] == pytest.approx(2.0)
    assert rub(1e-5, 1e-6, parameters)[0] == pytest.approx(5.0, rel=1e-6)


@given(above | st.floats(-10.0, -1e-3), above, above, above)
def test_creep_follows_its_own_velocity(free, compliance, sliding, creep):
    """Against scipy's bracketing root of velocity + c F_c tanh(velocity / w) = free."""
    def balance(velocity):
        return velocity + compliance * sliding * np.tanh(velocity / creep) - abs(free)

    force, _ = rub(free, compliance, (sliding, 0.0, 1.0, INF, creep))
    velocity = brentq(balance, 0.0, abs(free), xtol=1e-15)
    assert free - compliance * force == pytest.approx(
        np.copysign(velocity, free), rel=1e-9, abs=1e-12 * abs(free))


@given(number, above, bristles, st.floats(-1.0, 1.0))
def test_bristles_give_back_no_more_than_they_hold(free, compliance, parameters, share):
    """Passivity: the work done on friction is at least what the bristles store of it."""
    sigma, h = parameters[3], 5e-4
    z = share * parameters[0] / sigma
    force, z_next = rub(free, compliance, parameters, z, h)
    work = force * (free - compliance * force) * h
    stored = 0.5 * sigma * (z_next**2 - z**2)
    assert work >= stored - 1e-9 * max(1.0, abs(work), abs(stored))


@given(number, above, above)
def test_stiff_bristles_are_coulombs_friction(free, compliance, sliding):
    stiff, _ = rub(free, compliance, (sliding, 0.0, 1.0, 1e15, 0.0))
    rigid, _ = rub(free, compliance, (sliding, 0.0, 1.0, INF, 0.0))
    assert stiff == pytest.approx(rigid, rel=1e-6, abs=1e-9)
