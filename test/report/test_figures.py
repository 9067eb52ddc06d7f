"""The figures of a trace: one for each effect, spectra, thinning."""
from __future__ import annotations

import numpy as np
import pytest
from trace_by_hand import result

from hydro_twin.report.chart import envelope, plain
from hydro_twin.report.figures import illustrations, spectrum


def test_two_effects_on_one_plant_have_a_figure_each():
    drawn = illustrations(result('load_simulator'))
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


@pytest.mark.parametrize('short', [1, 2, 30])
def test_a_few_samples_between_two_gaps_do_not_change_a_spectrum(short):
    noise = np.random.default_rng(0).normal(size=5000)
    alone, together = (spectrum(pieces, 500.0) for pieces in (
        [noise], [noise[:short], noise, noise[:short]]))
    np.testing.assert_array_equal(alone, together)


@pytest.mark.parametrize('count', [999, 1000, 1001, 54_321])
def test_thinning_keeps_every_extreme(count):
    y = np.random.default_rng(count).standard_normal(count)
    x = 0.002 * np.arange(count)
    few_x, few_y = envelope(x, y, 1000)
    assert len(few_y) <= 1000
    assert (few_y.min(), few_y.max()) == (y.min(), y.max())
    assert few_x[0] == x[0]
    assert few_x[-1] <= x[-1] + (few_x[1] - few_x[0])
    at = few_x[np.argmax(few_y)]
    assert at == pytest.approx(x[np.argmax(y)], abs=2.0 * (few_x[1] - few_x[0]))


def test_a_chart_for_the_script_gives_back_its_points():
    drawn = illustrations(result('positioning'))[0]
    curve = drawn.views[0].charts[0].curves[0]
    plotted = plain(drawn)['views'][0]['charts'][0]['curves'][0]
    x = plotted['x']['start'] + plotted['x']['step'] * np.arange(len(plotted['y']))
    np.testing.assert_allclose(x, curve.x)
    np.testing.assert_allclose(plotted['y'], curve.y, rtol=1e-5)
