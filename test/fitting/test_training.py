"""Training against torch's own autograd and Rprop, alone and in a batch."""
from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydro_twin.errors import DataError, UserError
from hydro_twin.fitting.network import (
    initial_weights,
    Job,
    make_problem,
    Problem,
    SETTINGS,
    train_batch,
    train_many,
)
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.predictors.kind import Settings
from hydro_twin.recording.series import Series

SMALL = Settings(hidden=(6, 5), epochs=40)


def series(samples: int = 120, seed: int = 0) -> Series:
    """Make a stable response with a quadratic term, which no linear model has."""
    rng = np.random.default_rng(seed)
    u, theta = rng.normal([[0.3], [0.0]], size=(2, samples))
    y = np.zeros(samples)
    for k in range(1, samples):
        y[k] = 0.5 * y[k - 1] + 20.0 * u[k] ** 2 - 9.0 * theta[k - 1]
    return Series({'u_m': u, 'theta_d': 0.01 * theta, 'T_g': y}, 0.002)


@pytest.fixture(scope='module', autouse=True)
def torch() -> Any:
    """Import torch when the tests run: it takes seconds of each process that collects them."""
    torch = pytest.importorskip('torch')
    torch.set_num_threads(1)      # tiny products: more threads only wait for each other
    return torch


@pytest.fixture
def problem() -> Problem:
    return make_problem([series(seed=0), series(seed=1)], LOAD_SIMULATOR)


@pytest.mark.parametrize('decay', [0.0, 5e-4])
def test_steps_as_torch_does(torch: Any, problem: Problem, decay: float) -> None:
    """Every step of a batch of three, in double precision, against torch's own."""
    from hydro_twin.fitting import rprop
    sizes = [14, 6, 5, 1]
    x = torch.tensor((problem.regressors - problem.shift) / problem.scale)
    y = torch.tensor(problem.targets / problem.output_scale)
    weights = torch.tensor(np.stack([initial_weights(sizes, seed) for seed in range(3)]))
    models = []
    for start in weights:
        parts = [part[0] for layer in rprop.layers(start[None], sizes) for part in layer]
        parameters = [part.clone().requires_grad_() for part in parts]
        models.append((parameters, torch.optim.Rprop(parameters)))
    slope, previous = torch.empty_like(weights), torch.zeros_like(weights)
    steps = torch.full_like(weights, rprop.INITIAL_STEP)
    for _ in range(60):
        squares = rprop.gradient(weights, sizes, x.expand(3, -1, -1), y[None, :, None], decay,
                                 slope)
        rprop.rprop(weights, slope, previous, steps)
        for net, (parameters, optimizer) in enumerate(models):
            optimizer.zero_grad()
            w1, b1, w2, b2, w3, b3 = parameters
            output = torch.tanh(torch.tanh(x @ w1 + b1) @ w2 + b2) @ w3 + b3
            square = (output[:, 0] - y).square().sum()
            (0.5 * square + 0.5 * decay * sum(p.square().sum() for p in parameters)).backward()
            optimizer.step()
            flat = torch.cat([p.detach().reshape(-1) for p in parameters])
            torch.testing.assert_close(weights[net], flat, rtol=1e-9, atol=1e-9)
            assert squares[net].item() == pytest.approx(square.item(), rel=1e-9)


def test_a_batch_is_its_networks(problem: Problem) -> None:
    settings = replace(SMALL, epochs=10)        # rounding is magnified as training goes on
    jobs = [Job(settings, seed) for seed in range(4)]
    for job, trained in zip(jobs, train_batch(problem, jobs), strict=True):
        alone = train_batch(problem, [job])[0]
        np.testing.assert_allclose(trained.network.weights, alone.network.weights, atol=1e-4)
        np.testing.assert_allclose(trained.learning_curve, alone.learning_curve, rtol=1e-4)


def test_each_of_a_batch_has_its_own_rows(problem: Problem) -> None:
    rows = [np.arange(0, 100), np.arange(100, 200)]
    settings = replace(SMALL, epochs=10)
    batch = train_batch(problem, [Job(settings, 1, part) for part in rows])
    for part, trained in zip(rows, batch, strict=True):
        cut = replace(problem, regressors=problem.regressors[part], targets=problem.targets[part])
        alone = train_batch(cut, [Job(settings, 1)])[0]
        np.testing.assert_allclose(trained.learning_curve, alone.learning_curve, rtol=1e-4)


def test_learns_what_no_linear_model_can(problem: Problem) -> None:
    trained = train_batch(problem, [Job(Settings(hidden=(20,), epochs=300), 0)])[0]
    rows = np.column_stack([problem.regressors, np.ones(len(problem.targets))])
    linear = rows @ np.linalg.lstsq(rows, problem.targets)[0] - problem.targets
    error = trained.network(problem.regressors) - problem.targets
    assert np.sqrt(np.mean(error**2)) < 0.2 * np.sqrt(np.mean(linear**2))
    assert np.sqrt(np.mean(error**2)) == pytest.approx(trained.learning_curve[-1], rel=0.1)


def test_the_curve_starts_at_the_untrained_network(problem: Problem) -> None:
    trained = train_batch(problem, [Job(SMALL, 3)])[0]
    untrained = problem.network(SMALL, initial_weights([14, 6, 5, 1], 3))
    error = untrained(problem.regressors) - problem.targets
    assert trained.learning_curve[0] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-5)
    assert trained.learning_curve.shape == (40,)


@pytest.mark.slow
def test_a_seed_gives_the_same_network_in_any_process(problem: Problem) -> None:
    jobs = [Job(SMALL, seed) for seed in (7, 8, 7)]
    first, other, again = train_many(problem, jobs)
    assert first.network.weights.tolist() == again.network.weights.tolist()
    assert not np.array_equal(first.network.weights, other.network.weights)
    here = train_batch(problem, jobs[:1])[0]
    np.testing.assert_allclose(first.learning_curve[:10], here.learning_curve[:10], rtol=1e-4)


def test_watches_patterns_that_do_not_train(problem: Problem) -> None:
    other = make_problem([series(seed=5)], LOAD_SIMULATOR)
    settings = replace(SMALL, epochs=5)
    scored = train_batch(problem, [Job(settings, 1)], held_out=other)[0]
    plain = train_batch(problem, [Job(settings, 1)])[0]
    assert scored.network.weights.tolist() == plain.network.weights.tolist()
    assert np.isnan(plain.held_out_curve).all()
    untrained = problem.network(SMALL, initial_weights([14, 6, 5, 1], 1))
    error = untrained(other.regressors) - other.targets
    assert scored.held_out_curve[0] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-5)


def test_scales_as_the_paper(problem: Problem) -> None:
    inputs = (problem.regressors - problem.shift) / problem.scale
    np.testing.assert_allclose(inputs[:, 0], problem.regressors[:, 0] / 200.0)
    u = np.concatenate([series(seed=seed)['u_m'] for seed in (0, 1)])
    np.testing.assert_allclose(
        inputs[:, 4], (problem.regressors[:, 4] - u.mean()) / (3.0 * u.std()))
    assert problem.output_scale == 200.0


def test_a_hybrid_learns_the_error_of_what_is_predicted() -> None:
    stretches = [series(seed=0), series(seed=1)]
    predicted = [np.r_[np.full(4, np.nan), 0.9 * s['T_g'][4:]] for s in stretches]
    plain = make_problem(stretches, LOAD_SIMULATOR)
    hybrid = make_problem(stretches, LOAD_SIMULATOR, predicted)
    np.testing.assert_allclose(hybrid.targets, 0.1 * plain.targets, atol=1e-9)
    assert hybrid.output_scale == pytest.approx(3.0 * hybrid.targets.std())
    assert SETTINGS['hybrid'].hidden == (80,)


def changed(**columns: object) -> Series:
    return replace(series(), columns={**series().columns, **columns})


@pytest.mark.parametrize('bad', [
    series(samples=15),
    changed(T_g=np.ones(120)),
    changed(u_m=np.r_[np.nan, np.ones(119)]),
    changed(u_m=np.ones(120), theta_d=np.ones(120)),
])
def test_refuses_what_cannot_be_learnt_from(bad: Series) -> None:
    with pytest.raises(DataError):
        make_problem([bad], LOAD_SIMULATOR)


def test_refuses_a_device_that_is_not_there(problem: Problem) -> None:
    with pytest.raises(UserError, match='abacus'):
        next(train_many(problem, [Job(SMALL, 0)], 'abacus'))
