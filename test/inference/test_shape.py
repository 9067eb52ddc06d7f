"""What an effect does at its port: free curves against the law that made the data."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trace_by_hand import candidate, parts

from hydro_twin.fitting.output_error import free_run, residuals
from hydro_twin.fitting.port_signals import simulate_port_signals
from hydro_twin.inference.effect_signals import effect_signals
from hydro_twin.inference.search import search
from hydro_twin.inference.shape import component_plus_residual, dominant_signal, shape_of


def free(name, true, assumed):
    """Fit a free curve with the law assumed in the model, on data that the true one made."""
    made = parts(candidate(name, [true]), 1.2, 0.005, 3)
    model = candidate(name, [assumed])
    fit = replace(search(model, made, 1), candidate=model,
                  residual=np.concatenate(residuals(model, made)))
    placed = fit.candidate.effects[0]
    seen = [effect_signals(fit.candidate, placed, part) for part in made]
    over = dominant_signal(seen)
    return over, component_plus_residual(fit, placed, seen, over)


@pytest.mark.parametrize('assumed', [10.0, 6.0])
def test_friction_shows_whatever_strength_the_model_assumes(assumed):
    over, (curve,) = free('positioning', ('friction', 'motor', {'coulomb': 10.0}),
                          ('friction', 'motor', {'coulomb': assumed}))
    assert over == 'velocity'
    away = np.abs(curve.knots) > 0.1 * np.abs(curve.knots).max()
    off = np.abs(curve.added + 10.0 * np.sign(curve.knots))[away]
    assert np.all(off < 4.0 * curve.std_error[away])
    assert np.median(off) < 1.0


def test_a_knot_that_no_sample_is_near_has_no_curve():
    law = ('friction', 'motor', {'coulomb': 10.0})
    model = candidate('positioning', [law])
    made = parts(model, 1.2, 0.005, 3)
    fit = replace(search(model, made, 1), candidate=model)
    placed = fit.candidate.effects[0]
    seen = [effect_signals(fit.candidate, placed, part) for part in made]
    # A speed in two bands, with nothing between them.
    apart = [replace(one, signals={'velocity': np.where(
        one.signals['velocity'] > 0.0, 1.0, -1.0) + 0.01 * one.signals['velocity']})
        for one in seen]
    (curve,) = component_plus_residual(fit, placed, apart, 'velocity')
    far = np.abs(np.abs(curve.knots) - 1.0) > 0.5
    assert far.any()
    assert np.isinf(curve.std_error[far]).all()
    assert np.isfinite(curve.std_error[~far]).any()


def test_a_drift_is_not_drawn_in_a_pause():
    made = candidate('load_simulator', [('drift', 'G', {'rate': 0.5, 'begin': 0.0, 'end': 60.0})])
    some = [replace(part, start=k * 30_000_000_000)
            for k, part in enumerate(parts(made, 1.2, 0.005, 3))]
    shown = shape_of(search(made, some, 1), made.effects[0], some)
    recorded = [round(1e-9 * part.start) for part in some]
    assert len(shown.free.knots) < 8
    assert all(min(abs(knot - begin) for begin in recorded) < 10.0 for knot in shown.free.knots)


def test_a_dead_zone_shows():
    width = 4e-5
    law = ('dead_zone', 'spool', {'width': width})
    over, (curve,) = free('load_simulator', law, law)
    assert over == 'value'
    assert np.abs(curve.knots).max() > 1.5 * width
    np.testing.assert_allclose(curve.added, -np.clip(curve.knots, -width, width), atol=0.2 * width)


def test_a_law_with_memory_has_two_branches():
    law = ('hysteresis', 'command', {'width': 0.2})
    _, (rising, falling) = free('load_simulator', law, law)
    middle = np.abs(rising.knots) < 0.5 * np.abs(rising.knots).max()
    np.testing.assert_allclose(rising.added[middle], -0.2, atol=0.03)
    np.testing.assert_allclose(falling.added[middle], 0.2, atol=0.03)


@pytest.mark.parametrize('others', [
    [], [('drift', 'G', {'rate': 0.5, 'begin': 0.0, 'end': 0.6})]])
def test_what_passes_at_a_port_is_what_the_run_saw(others):
    made = candidate('load_simulator', [('dead_zone', 'spool', {'width': 3e-6}), *others])
    part = parts(made, 0.6, 0.0, 0)[0]
    got = effect_signals(made, made.effects[0], part)
    (seen,) = simulate_port_signals(made, [part])
    row = made.plant.ports.index(made.effects[0].port)
    np.testing.assert_allclose(got.signals['value'] + got.added, seen[:, row], atol=1e-12)
    np.testing.assert_allclose(got.left, part.measured - free_run(made, part), atol=1e-9)


@pytest.mark.parametrize(('effect', 'true'), [
    (('delay', 'command', {'time': 0.006}), 0.006),
    (('lag', 'sensor', {'time_constant': 0.006}), 0.006),
    (('mode', 'command', {'natural_frequency': 8.0, 'damping_ratio': 0.5}), 8.0)])
def test_the_error_over_a_parameter_of_linear_dynamics_is_least_at_the_true_one(effect, true):
    truth = candidate('load_simulator', [effect])
    made = parts(truth, 0.6, 0.01, 4)
    fit = search(truth, made, 1)
    profile = shape_of(fit, fit.candidate.effects[0], made)
    assert np.isfinite(profile.errors).all()
    assert profile.values[np.argmin(profile.errors)] == pytest.approx(true, rel=0.1)
    at_fit = np.interp(fit.candidate.effects[0].values[0], profile.values, profile.errors)
    assert at_fit == pytest.approx(profile.error, rel=0.02)
