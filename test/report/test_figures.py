"""The figures of a trace: free curves against the law that made the data, spectra, thinning."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trace_by_hand import candidate, parts, trace

from hydro_twin.report.chart import plain, thin
from hydro_twin.report.figures import illustrations, runs, spectrum
from hydro_twin.report.shape import free_curves, illustrate_effect, telling
from hydro_twin.residual.passing import passing
from hydro_twin.residual.select import search
from hydro_twin.residual.verdict import judge


def free(name, true, assumed):
    """Fit a free curve with the law assumed in the model, on data that the true one made."""
    made = parts(candidate(name, [true]), 1.2, 0.005, 3)
    model = candidate(name, [assumed])
    fit = replace(search(model, made, 1), candidate=model,
                  residual=np.concatenate([model.residual(part) for part in made]))
    placed = fit.candidate.effects[0]
    seen = [passing(fit.candidate, placed, part) for part in made]
    over = telling(seen)
    return over, free_curves(fit, placed, seen, over)


@pytest.mark.parametrize('assumed', [10.0, 6.0])
def test_friction_shows_whatever_strength_the_model_assumes(assumed):
    over, (curve,) = free('positioning', ('friction', 'motor', {'coulomb': 10.0}),
                          ('friction', 'motor', {'coulomb': assumed}))
    assert over == 'velocity'
    away = np.abs(curve.knots) > 0.1 * np.abs(curve.knots).max()
    off = np.abs(curve.added + 10.0 * np.sign(curve.knots))[away]
    assert np.all(off < 4.0 * curve.std_error[away])
    assert np.median(off) < 1.0


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


def test_what_passes_at_a_port_is_what_the_run_saw():
    made = candidate('load_simulator', [('dead_zone', 'spool', {'width': 3e-6})])
    part = parts(made, 0.6, 0.0, 0)[0]
    got = passing(made, made.effects[0], part)
    seen = np.zeros((len(part.inputs), len(made.system.H)))
    y = made.run(part, seen)
    row = made.plant.ports.index(made.effects[0].port)
    np.testing.assert_allclose(got.signals['value'] + got.added, seen[:, row], atol=1e-12)
    np.testing.assert_allclose(got.left, part.measured - y, atol=1e-9)


def test_the_error_over_a_delay_is_least_at_the_true_one():
    truth = candidate('load_simulator', [('delay', 'command', {'time': 0.006})])
    made = parts(truth, 0.6, 0.01, 4)
    fit = search(truth, made, 1)
    drawn = illustrate_effect(fit, fit.candidate.effects[0], made)
    errors = drawn.views[0].charts[0].curves[0]
    assert errors.x[np.argmin(errors.y)] == pytest.approx(0.006, abs=0.0006)


def test_two_effects_on_one_plant_have_a_figure_each():
    made = trace('load_simulator')
    verdict = judge(made)
    drawn = illustrations(made, verdict, runs(made))
    assert [one.name for one in drawn] == ['output', 'effect_friction_motor',
                                           'effect_delay_command', 'spectra']
    assert [view.label for view in drawn[0].views] == [
        f'{part} {k}, a bag' for part in ('test', 'training') for k in (1, 2, 3)]


def test_the_spectrum_holds_the_power():
    noise = np.random.default_rng(0).standard_normal(40_000)
    frequency, density = spectrum([noise[:10_000], noise[10_000:]], 500.0)
    assert np.sum(density**2) * frequency[1] == pytest.approx(1.0, rel=0.05)
    time = np.arange(20_000) / 500.0
    frequency, density = spectrum([3.0 * np.sin(2 * np.pi * 50.0 * time)], 500.0)
    assert frequency[np.argmax(density)] == pytest.approx(50.0, abs=0.5)


@pytest.mark.parametrize('count', [999, 1000, 1001, 54_321])
def test_thinning_keeps_every_extreme(count):
    y = np.random.default_rng(count).standard_normal(count)
    x = 0.002 * np.arange(count)
    few_x, few_y = thin(x, y, 1000)
    assert len(few_y) <= 1000
    assert (few_y.min(), few_y.max()) == (y.min(), y.max())
    assert few_x[0] == x[0]
    assert few_x[-1] <= x[-1] + (few_x[1] - few_x[0])
    at = few_x[np.argmax(few_y)]
    assert at == pytest.approx(x[np.argmax(y)], abs=2.0 * (few_x[1] - few_x[0]))


def test_a_chart_for_the_script_gives_back_its_points():
    made = trace('positioning')
    verdict = judge(made)
    drawn = illustrations(made, verdict, runs(made))[0]
    curve = drawn.views[0].charts[0].curves[0]
    told = plain(drawn)['views'][0]['charts'][0]['curves'][0]
    x = told['x']['start'] + told['x']['step'] * np.arange(len(told['y']))
    np.testing.assert_allclose(x, curve.x)
    np.testing.assert_allclose(told['y'], curve.y, rtol=1e-5)
