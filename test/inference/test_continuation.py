"""Short windows: a start where a search over long ones is led astray, and a check of names."""
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.context import Context
from hydro_twin.inference.continuation import (
    from_short_windows,
    shorter_horizon,
    with_rivals_of_short_windows,
)
from hydro_twin.inference.findings import Finding, Selection
from hydro_twin.inference.search import search
from hydro_twin.inference.select import fit_alternatives
from hydro_twin.inference.trace import evidence
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series

PLANT, T, NOISE = plant_named('rotary_axis'), 0.004, 1e-4
RIPPLE = {'cosine': 0.5, 'sine': 0.2, 'periods': 6.0}


def cogging():
    """Run a drive whose torque ripples, over a turn and more in each of four series."""
    values, rng = {'J': 0.02, 'B': 0.1}, np.random.default_rng(0)
    system = Model(PLANT, values, T, (place('ripple', 'motor', RIPPLE, PLANT),), substeps=8).system
    time, parts = T * np.arange(350), []
    for hertz in (0.5, 0.7, 0.9, 1.1):
        torque = 2.0 * np.sin(2 * np.pi * hertz * time) + rng.normal(0.0, 0.5, len(time))
        theta = system.run(torque[:, None], np.zeros(2))
        parts.append(Part(torque[:, None], theta + NOISE * rng.standard_normal(len(time))))
    return parts


def test_a_ripple_that_a_long_run_meets_in_the_wrong_phase():
    parts = cogging()
    base = fit_linear(PLANT, parts, {}, T)
    context = Context(parts, parts, (0.0, 1.0), 0, lambda _: None)
    best = from_short_windows(base, context)[0]
    assert best.effects[-1].effect.id == 'ripple'
    assert best.effects[-1].named['periods'] == pytest.approx(6.0, rel=0.01)

    without, known = (
        fit_alternatives(base, parts, context.times, 4, afresh=True, known=some)[0].fit
        for some in ([], [best]))
    assert known.error < 1.1 * NOISE < 0.1 * without.error


def test_a_plant_that_forgets_needs_none():
    plant = plant_named('control_valve')
    command = np.repeat([0.2, 0.7, 0.4], 100)[:, None]
    model = Model(plant, {'tau': 1.0, 'K': 1.0}, 0.1)
    parts = [Part(command, model.system.run(command, np.array([0.2])))]
    context = Context(parts, parts, (0.0, 1.0), 0, lambda _: None)
    assert from_short_windows(fit_linear(plant, parts, {}, 0.1), context) == []


def test_a_rival_that_is_better_on_short_windows_is_as_near():
    plant = plant_named('positioning')
    laws = [place('friction', 'motor', {'coulomb': 20.0}, plant),
            place('dead_zone', 'command', {'width': 20.0}, plant)]
    rig = Model(plant, {'M': 100.0, 'F_v': 200.0}, 0.01, (laws[0],), substeps=4)
    time, rng, parts = 0.01 * np.arange(600), np.random.default_rng(0), []
    for hertz in (0.3, 0.4):
        force = 60.0 * np.sin(2 * np.pi * hertz * time)[:, None]
        x = rig.system.run(force, np.zeros(2))
        parts.append(Part(force, x + 1e-5 * rng.standard_normal(len(time))))
    context = Context(parts, parts, (0.0, 1.0), 0, lambda _: None)
    distances = []
    for law, rival in (laws, laws[::-1]):
        fit = search(Model(plant, rig.values, 0.01, (law,), substeps=4), parts, 40)
        selection = Selection(fit, (Finding(0, 0.0, 1.0, ((rival, 500.0),)),))
        (found,) = with_rivals_of_short_windows(selection, context).findings
        distances.append(found.rivals[0][1])
    assert distances == [500.0, 0.0]


def two_speeds():
    """Run a drive with dry friction at 220 rad/s and back at 110, and change within 0.1 s."""
    values, change = {'J': 2e-4, 'B': 2e-3}, 100
    rig = Model(PLANT, values, 0.001, (place('friction', 'motor', {'coulomb': 0.7}, PLANT),),
                substeps=4)
    speeds = np.repeat([-110.0, 220.0, -110.0, 220.0, -110.0], [700, 600, 400, 500, 900])
    torque = values['B'] * speeds + 0.7 * np.sign(speeds)
    for k in np.flatnonzero(np.diff(speeds)) + 1:
        torque[k:k + change] += values['J'] * (speeds[k] - speeds[k - 1]) / (0.001 * change)
    theta = rig.system.run(torque[:, None], np.array([-110.0, 0.0]))
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(theta))
    return [Part(torque[:, None], theta + noise)]


def test_friction_where_a_linear_fit_to_long_runs_ends_without_inertia():
    parts = two_speeds()
    base = fit_linear(PLANT, parts, {}, 0.001)
    assert base.candidate.values['J'] < 1e-6
    context = Context(parts, parts, (0.0, 1.0), 0, lambda _: None)
    best, *others = from_short_windows(base, context)
    assert best.effects[-1].effect.id == 'friction'
    assert best.effects[-1].named['coulomb'] == pytest.approx(0.7, rel=0.01)
    assert best.values['J'] == pytest.approx(2e-4, rel=0.01)
    assert 'ripple' in [one.effects[-1].effect.id for one in others]


def swung_over_the_top(seed):
    """Swing a pendulum up and over, pushed along where it turns and back where it is fast."""
    rng = np.random.default_rng(seed)
    state, theta, torque = np.array([rng.uniform(-0.5, 0.5), 0.0]), [], []
    for _ in range(900):
        push = 1.5 if abs(state[1]) < 9.0 else -1.5
        torque.append(push * np.sign(state[1] or 1.0) + 0.3 * rng.standard_normal())
        theta.append(state[0])
        state = solve_ivp(lambda _, y, u=torque[-1]: (
            y[1], (u - 0.02 * y[1] - 3.5 * np.sin(y[0])) / 0.18), (0.0, 0.005), state,
            rtol=1e-8, atol=1e-10).y[:, -1]
    measured = np.array(theta) + 1e-3 * rng.standard_normal(len(theta))
    return Series({'torque': np.array(torque), 'theta': measured}, 0.005, start=10**11 * seed)


@pytest.mark.slow
def test_the_horizon_is_as_long_as_a_pendulum_can_be_followed():
    """Near the top it falls to either side: no run follows over 10 s, under the right laws."""
    recording = Recording(tuple(swung_over_the_top(seed) for seed in range(4)))
    found = evidence(recording, None, PLANT)
    assert found.plant.horizon < 2.5
    (gravity,) = found.final.candidate.effects
    assert gravity.effect.id == 'ripple'
    assert gravity.named['periods'] == pytest.approx(1.0, rel=0.01)
    assert gravity.named['sine'] == pytest.approx(-3.5, rel=0.03)
    assert found.after.error < 1.1e-3


def test_the_horizon_is_not_shortened_where_a_linear_model_follows():
    parts = [Part(part.inputs, part.measured) for part in cogging()]
    base = fit_linear(PLANT, parts, {}, T)
    assert shorter_horizon(base, parts, (0.0, 1.0), lambda _: None) is None
