"""Parts that whiten what a model leaves of them."""
from dataclasses import replace

from coloured_noise import coloured
import numpy as np
import pytest
import sampled_valve
from scipy.signal import lfilter

from hydro_twin.fitting.coloured import as_measured, is_coloured, whitened
from hydro_twin.fitting.output_error import (
    fitted_residuals,
    free_run,
    initial_states,
    residuals,
    residuals_from,
)
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import plant_unknowns, unknowns_of
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named

PLANT = plant_named('cylinder')
MODEL = Model(PLANT, {**PLANT.constant_values(), 'tau': 0.05, 'K_v': 0.02}, 0.02)
WALK = np.array([1.0, -0.98])


def part(seed, memory):
    """Half a minute of steps, and noise of a tenth of a millimetre."""
    rng = np.random.default_rng(seed)
    command = np.repeat(rng.uniform(-2.0, 2.0, 60), 25)[:, None]
    clean = MODEL.system.run(command, np.zeros(PLANT.order))
    return Part(command, clean + coloured(seed, len(clean), memory, 1e-4))


def test_the_free_run_is_filtered_as_scipy_does():
    plain = part(0, 0.98)
    white = replace(plain, filters=(WALK,))
    missed = plain.measured - free_run(MODEL, plain)
    found, = residuals(MODEL, [white])
    np.testing.assert_allclose(found, lfilter(WALK, [1.0], missed)[MODEL.start_up:], atol=1e-15)


@pytest.mark.parametrize('found', [
    lambda parts: fitted_residuals(MODEL, parts),
    lambda parts: residuals_from(MODEL, parts, initial_states(MODEL, parts).x)])
def test_the_start_is_eliminated_after_the_filter(found):
    """The least squares problem of the filtered rows, weighted as if all counted alike."""
    plain = replace(part(1, 0.98), filters=(WALK,))
    n = MODEL.start_up
    x, = initial_states(MODEL, [plain]).x
    missed = lfilter(WALK, [1.0], plain.measured - MODEL.system.run(plain.inputs, x))
    rows = lfilter(WALK, [1.0], MODEL.system.free_response(len(missed)), axis=0)
    first = np.sqrt(np.mean(missed[:n] ** 2))
    weight = np.where(np.arange(len(missed)) < n,
                      max(1.0, np.sqrt(np.mean(missed[n:] ** 2)) / first), 1.0)
    x = np.linalg.lstsq(weight[:, None] * rows, weight * missed)[0]
    left, = found([plain])
    np.testing.assert_allclose(left, (missed - rows @ x)[n:], atol=1e-3 * np.std(left))


def test_a_filter_of_the_noise_leaves_what_is_new_in_each_sample():
    plain = [part(seed, 0.95) for seed in (2, 3)]
    fit = Problem(MODEL, plant_unknowns(PLANT, 'physical'), plain).solve()
    assert is_coloured(fit)
    white = Problem(MODEL, plant_unknowns(PLANT, 'physical'), whitened(plain, fit)).solve()
    rho = np.corrcoef(white.residual[1:], white.residual[:-1])[0, 1]
    assert abs(rho) < 0.05
    again = as_measured(white, plain)
    assert again.candidate == white.candidate
    assert again.error == pytest.approx(fit.error, rel=0.1)
    assert again.whitened[0] is white.residual


@pytest.mark.parametrize(('memory', 'expected'), [(0.0, False), (0.8, False), (0.95, True)])
def test_noise_of_a_long_memory_only_is_coloured(memory, expected):
    plain = [part(seed, memory) for seed in (4, 5)]
    fit = Problem(MODEL, plant_unknowns(PLANT, 'physical'), plain).solve()
    assert is_coloured(fit) == expected


@pytest.mark.parametrize('seed', range(3))
def test_commands_between_two_samples_make_a_random_walk_that_hides_a_lag(seed):
    parts = [sampled_valve.recorded(seed)]
    zone = place('dead_zone', 'command', {'width': 0.8, 'centre': -0.3}, PLANT)
    model = replace(MODEL, sample_time=sampled_valve.SAMPLE_TIME, effects=(zone,))
    plain = Problem(model, unknowns_of(model), parts).solve()
    white = Problem(model, unknowns_of(model), whitened(parts, plain)).solve().candidate
    assert is_coloured(plain)
    assert abs(plain.candidate.values['tau'] / sampled_valve.LAG - 1.0) > 0.3
    assert white.values == pytest.approx({
        **white.values, 'tau': sampled_valve.LAG, 'K_v': sampled_valve.GAIN}, rel=0.2)
    assert white.effects[0].named['width'] == pytest.approx(0.95, abs=0.03)
    assert white.timing['command'] == pytest.approx(-0.025, abs=0.004)
