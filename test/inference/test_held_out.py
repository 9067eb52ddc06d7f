"""The interval of an improvement, on residuals whose true improvement is known."""
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_twin.fitting import output_error
from hydro_twin.fitting.parts import parts_of
from hydro_twin.inference.held_out import (
    geometric_improvement,
    improvement,
    p_of_no_gain,
    residuals,
    surer_improvement,
)
from hydro_twin.model import Model
from hydro_twin.plants import plant_named
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Recording
from hydro_twin.simulation.simulate import simulate


def pair(seed, after, memory=0.6, n=1000):
    """Residuals of three stretches; the true improvement is 1 - after^2 / 2."""
    rng = np.random.default_rng(seed)

    def draw():
        return [lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal(n))
                for _ in range(3)]

    common, lacking = draw(), draw()
    before = [a + b for a, b in zip(common, lacking, strict=True)]
    return before, [after * a for a in common]


@pytest.mark.parametrize('after', [0.3, 1.0, 1.35])
def test_the_interval_covers_the_truth(after):
    truth = 1 - after**2 / 2
    found = [improvement(*pair(seed, after), seed) for seed in range(150)]
    covered = np.mean([one.low <= truth <= one.high for one in found])
    assert covered > 0.93                   # 98 % by design, less what few blocks cost
    assert np.mean([one.relative for one in found]) == pytest.approx(truth, abs=0.02)
    assert all(one.low <= one.relative <= one.high for one in found)


def test_another_draw_of_the_same_noise_is_no_improvement():
    rng = np.random.default_rng(0)
    false = sum(improvement([rng.standard_normal(1000)], [rng.standard_normal(1000)], seed).low > 0
                for seed in range(200))
    assert false <= 8                       # 1 % by design


def test_doubts_are_as_likely_as_they_say():
    """Of two draws of the same noise each is the smaller in half of all cases, at any doubt."""
    rng = np.random.default_rng(0)
    doubts = [p_of_no_gain([rng.standard_normal(1000)], [rng.standard_normal(1000)], seed)
              for seed in range(300)]
    for level in (0.1, 0.5, 0.9):
        assert np.mean(np.array(doubts) < level) == pytest.approx(level, abs=0.09)
    before, after = pair(0, 0.3)
    assert p_of_no_gain(before, after, 0) == 0.0
    assert p_of_no_gain(after, before, 0) == 1.0


def test_of_two_models_as_wrong_as_each_other_none_is_better_at_a_high_rate():
    """Their errors change slowly: within 0.2 s at 1 kHz, where 50 samples know nothing of it."""
    memory = np.exp(-1 / 200)

    def drawn(rng):
        return lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal(25_000))[1000:]

    def false(seed):
        rng = np.random.default_rng(seed)
        common = rng.standard_normal(24_000) + drawn(rng)
        return improvement([common + 0.4 * drawn(rng)], [common + 0.4 * drawn(rng)], seed).low > 0

    assert sum(map(false, range(100))) <= 6         # 1 % by design, 12 with blocks of 50


def test_nothing_changed_is_zero():
    before, _ = pair(3, 1.0)
    same = improvement(before, before, 0)
    assert (same.relative, same.low, same.high) == (0.0, 0.0, 0.0)


def test_units_do_not_matter_and_seeds_hardly():
    before, after = pair(4, 0.8)
    one = improvement(before, after, 0)
    scaled = improvement([1e3 * r for r in before], [1e3 * r for r in after], 0)
    assert scaled.low == pytest.approx(one.low)
    assert improvement(before, after, 1).low == pytest.approx(one.low, abs=0.02)
    assert improvement(before, after, 0) == one


def test_one_bad_window_does_not_hide_what_the_others_show():
    """Seven windows of eight come to a third; in one, where all is wrong, a half is added."""
    rng = np.random.default_rng(0)
    common = [rng.standard_normal(180) for _ in range(8)]
    before = [r * (8.0 if k == 6 else 3.0) for k, r in enumerate(common)]
    after = [r * (12.0 if k == 6 else 1.0) for k, r in enumerate(common)]
    assert improvement(before, after, 0).low < 0.0
    usual = geometric_improvement(before, after, 0)
    assert 0.0 < usual.low < usual.relative < usual.high < 1.0
    assert surer_improvement(before, after, 0) == usual
    assert geometric_improvement(after, before, 0).high < 0.0


def test_what_happens_seldom_and_much_shows_in_the_mean_square():
    """A stop that is met in a third of the windows; the others hardly change, for the worse."""
    rng = np.random.default_rng(0)
    common = [rng.standard_normal(50) for _ in range(30)]
    before = [r * (20.0 if k % 3 == 0 else 1.0) for k, r in enumerate(common)]
    after = [r * (3.0 if k % 3 == 0 else 1.02) for k, r in enumerate(common)]
    assert surer_improvement(before, after, 0) == improvement(before, after, 0)
    assert improvement(before, after, 0).low > 0.9


@pytest.mark.parametrize('compare', [geometric_improvement, surer_improvement])
def test_another_draw_of_coloured_noise_is_no_improvement_by_either(compare):
    found = [compare(*pair(seed, 2**0.5), seed) for seed in range(200)]
    assert sum(one.low > 0 for one in found) <= 10
    assert np.mean([one.relative for one in found]) == pytest.approx(0.0, abs=0.03)


@dataclass(frozen=True)
class Fitted:
    """All that is asked of a fit."""

    candidate: Model


def test_the_error_of_a_start_is_not_blamed_on_the_laws():
    """A mass drifts off with the error of its first velocity, though its laws are true."""
    plant, values, noise = plant_named('positioning'), {'M': 95.0, 'F_v': 20.0}, 1e-4
    one = simulate(plant, values, [], {'force': lambda t: 50 * np.sin(2 * np.pi * t)}, 3.5)
    one = one.part(500, 3500)       # from amid its motion
    x = one['x'] + noise * np.random.default_rng(0).standard_normal(len(one))
    parts = parts_of(Recording((replace(one, columns={**one.columns, 'x': x}),)), plant)
    fit = Fitted(Model(plant, values, plant.sample_time))
    assert rms(output_error.residuals(fit.candidate, parts)[0]) > 3 * noise
    assert rms(residuals(fit, parts)[0]) == pytest.approx(noise, rel=0.05)
    wrong = Fitted(Model(plant, {**values, 'F_v': 40.0}, plant.sample_time))
    assert rms(residuals(wrong, parts)[0]) > 3 * noise
