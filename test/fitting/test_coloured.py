"""The fit by the likelihood of coloured noise, and when what is left is not taken for such."""
from dataclasses import replace

from coloured_noise import coloured
import numpy as np
import pytest
from scipy.linalg import toeplitz

from hydro_twin.fitting.coloured import with_coloured_noise
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.output_error import free_run
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import plant_unknowns
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named

PLANT = plant_named('load_simulator')
VALUES = PLANT.constant_values() | PLANT.middle()
VALVE = plant_named('control_valve')
DT = 0.002


def steps(seed, memory, *effects, sensor=None):
    """Two parts of 3 s: random steps of the command, noise of 0.5 N m on the torque."""
    model = Model(PLANT, VALUES, DT, tuple(place(*effect, PLANT) for effect in effects),
                  substeps=4)
    t, parts = DT * np.arange(1500), []
    for k in range(2):
        rng = np.random.default_rng(k)
        edges = np.cumsum(rng.uniform(0.05, 0.5, 40))
        u = rng.uniform(-0.3, 0.3, 41)[np.searchsorted(edges, t)]
        inputs = np.column_stack([u, 0.02 * np.sin(2 * np.pi * 1.3 * t)])
        part = Part(inputs, np.zeros(len(t)), start=10_000_000_000 * k)
        clean = model.system.run(inputs, model.system.start(inputs[0], 0.0))
        parts.append(replace(part, measured=clean + coloured(100 * seed + k, len(t), memory, 0.5)))
    return parts


def fitted(parts):
    return fit_linear(PLANT, parts, PLANT.constant_values(), DT)


def test_is_generalised_least_squares():
    """The output is linear in a gain: Aitken's formula, scored samples given those before."""
    n, memory = 3000, 0.9
    rng = np.random.default_rng(3)
    command = np.repeat(rng.uniform(0.0, 1.0, n // 5), 5)
    valve = replace(VALVE, start_up=10.0)       # by then the state at the start is forgotten
    true = Model(valve, {'tau': 0.3, 'K': 1.0}, 0.1)
    shape = true.system.run(command[:, None], np.array([0.0]))
    start = true.system.free_response(n)[:, 0]
    part = Part(command[:, None], shape + coloured(5, n, memory, 0.3),
                filters=(np.array([1.0, -memory]),))
    unknowns = [u for u in plant_unknowns(valve, 'physical') if u.name == 'K']
    found = Problem(true, unknowns, [part]).solve(tolerance=1e-12)
    X = np.column_stack([shape, start])
    W = np.linalg.inv(np.linalg.cholesky(toeplitz(memory ** np.arange(n))))[true.start_up:]
    expected = np.linalg.lstsq(W @ X, W @ part.measured)[0][0]
    ordinary = np.linalg.lstsq(X[true.start_up:], part.measured[true.start_up:])[0][0]
    assert found.candidate.values['K'] == pytest.approx(expected, rel=1e-6)
    assert abs(ordinary - expected) > 0.02


def test_white_noise_is_fitted_as_it_is():
    parts = steps(0, 0.0)
    fit = fitted(parts)
    assert with_coloured_noise(fit, parts) is fit


@pytest.mark.parametrize('effect', [
    ('friction', 'motor', {'coulomb': 4.0}), ('dead_zone', 'command', {'width': 0.01})])
@pytest.mark.parametrize('memory', [0.0, 0.9])
def test_what_a_lacking_law_leaves_is_no_noise(effect, memory):
    parts = steps(1, memory, effect)
    fit = fitted(parts)
    assert with_coloured_noise(fit, parts) is fit


def test_what_moves_the_estimates_is_no_noise():
    """An offset that slow noise hides: with the gain of the fast changes the run is off by it."""
    n, rng = 3000, np.random.default_rng(0)
    edges = np.cumsum(rng.uniform(1.0, 5.0, n))
    command = rng.uniform(0.6, 1.0, n + 1)[np.searchsorted(edges, 0.1 * np.arange(n))][:, None]
    run = Model(VALVE, {'tau': 0.5, 'K': 1.15}, 0.1).system.run(command, np.array([0.7]))
    walk = 0.002 * np.cumsum(rng.standard_normal(n))
    parts = [Part(command, run - 0.12 + walk + 0.004 * rng.standard_normal(n))]
    fit = fit_linear(VALVE, parts, VALVE.constant_values(), 0.1)
    assert with_coloured_noise(fit, parts) is fit


def test_the_residual_stays_measured_less_run():
    parts = steps(2, 0.9)
    fit = with_coloured_noise(fitted(parts), parts)
    assert fit.whitened
    left = np.concatenate([part.measured - free_run(fit.candidate, part) for part in parts])
    assert fit.error == pytest.approx(0.5, rel=0.1)
    assert np.corrcoef(fit.residual, left.reshape(2, -1)[:, fit.candidate.start_up:].ravel()
                       )[0, 1] > 0.99
    bare = replace(fit, whitened=None)
    assert isinstance(bare, Fit)
    assert bare.identifiability().std_error['K_p'] != fit.identifiability().std_error['K_p']


@pytest.mark.slow
def test_estimates_scatter_less_and_as_much_as_is_said():
    """Thirty draws of AR(1) with 0.9, under random steps."""
    errors = {'ordinary': [], 'coloured': []}
    within = []
    for seed in range(30):
        parts = steps(seed, 0.9)
        fit = fitted(parts)
        again = with_coloured_noise(fit, parts)
        assert again.whitened
        for name, one in (('ordinary', fit), ('coloured', again)):
            errors[name].append([np.log(one.candidate.values[p] / VALUES[p])
                                 for p in ('K_p', 'K_ce', 'B_m')])
        known = again.identifiability().std_error
        within.append([abs(error) < 2.0 * known[p]
                       for p, error in zip(('K_p', 'K_ce', 'B_m'), errors['coloured'][-1],
                                           strict=True)])
    size = {name: np.sqrt(np.mean(np.square(some), axis=0)) for name, some in errors.items()}
    assert (size['coloured'] < 0.85 * size['ordinary']).all()
    assert np.mean(within) > 0.88
