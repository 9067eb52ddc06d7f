"""The compiled GRU against torch's equations, its file, and its runs."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_twin.errors import ModelError
from hydro_twin.model import load_predictor, Model, write_model
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.predictors.network import Network, network_bytes
from hydro_twin.predictors.network_predictor import load_network, NetworkPredictor
from hydro_twin.predictors.recurrent import Recurrent
from hydro_twin.recording.series import Series

H, R = 6, 14
CONSTANTS = {'D_m': 2e-5}
MODEL = Model(LOAD_SIMULATOR, CONSTANTS, 0.002, kind='gru', network='net.safetensors')


def make(seed: int = 0) -> Recurrent:
    rng = np.random.default_rng(seed)
    return Recurrent(np.array([R, H, 1]), rng.normal(0, 0.4, 3 * H * (R + H + 1) + H + 1),
                     rng.normal(size=R), rng.uniform(0.5, 2.0, R), 20.0, 1e4)


def by_hand(network: Recurrent, rows: np.ndarray) -> np.ndarray:
    """Run the three equations of the GRU in plain numpy."""
    W, U, U_n, b, out, bias = np.split(
        network.weights, np.cumsum([R * 3 * H, 2 * H * H, H * H, 3 * H, H]))
    W, U, U_n = W.reshape(R, 3 * H), U.reshape(H, 2 * H), U_n.reshape(H, H)
    h, outputs = np.zeros(H), []
    for row in (rows - network.shift) / network.scale:
        driven = row @ W + b
        z, r = np.split(1 / (1 + np.exp(-(driven[:2 * H] + h @ U))), 2)
        h = z * h + (1 - z) * np.tanh(driven[2 * H:] + (r * h) @ U_n)
        outputs.append(network.output_scale * (h @ out + bias[0]))
    return np.array(outputs)


def series(samples: int = 90) -> Series:
    rng = np.random.default_rng(1)
    return Series({'u_m': rng.normal(size=samples), 'theta_d': rng.normal(size=samples),
                   'T_g': rng.normal(0, 20, samples)}, 0.002)


def test_is_the_textbook_formula() -> None:
    rows = np.random.default_rng(2).normal(size=(40, R))
    np.testing.assert_allclose(make()(rows), by_hand(make(), rows), rtol=1e-12)


def test_training_and_prediction_are_one_arithmetic() -> None:
    """Sums of squares over one window by torch, against the compiled prediction."""
    torch = pytest.importorskip('torch')
    from hydro_twin.fitting import recurrent
    network, rows = make(), np.random.default_rng(3).normal(size=(30, R))
    x = torch.tensor((rows - network.shift) / network.scale)[None]
    sums = recurrent.squares(torch.tensor(network.weights)[None], [R, H, 1], x,
                             torch.zeros(1, 30, dtype=torch.float64), torch.ones(1, 30))
    assert sums.item() == pytest.approx(np.sum((network(rows) / 20.0) ** 2), rel=1e-10)


def test_the_gradient_is_that_of_differences() -> None:
    torch = pytest.importorskip('torch')
    from hydro_twin.fitting import recurrent
    rng = np.random.default_rng(4)
    x, y = torch.tensor(rng.normal(size=(3, 20, R))), torch.tensor(rng.normal(size=(3, 20)))
    scored = torch.tensor(rng.random((3, 20)) < 0.7)
    weights = torch.tensor(np.stack([make(seed).weights for seed in (5, 6)]))
    out = torch.empty_like(weights)
    recurrent.gradient(weights, [R, H, 1], x, y, scored, 0.1, out)

    def cost(w: Any) -> Any:
        return (0.5 * recurrent.squares(w, [R, H, 1], x, y, scored)
                + 0.05 * w.square().sum(1))

    for i in rng.choice(weights.shape[1], 12, replace=False):
        step = torch.zeros_like(weights)
        step[:, i] = 1e-6
        slope = (cost(weights + step) - cost(weights - step)) / 2e-6
        np.testing.assert_allclose(out[:, i], slope, rtol=1e-5, atol=1e-7)


def test_every_pattern_is_scored_once() -> None:
    pytest.importorskip('torch')
    from hydro_twin.fitting.recurrent import windows
    rows, scored = windows([95, 7, 200, 50])
    assert sorted(rows[scored]) == list(range(352))
    for k, begin in ((0, 0), (95, 95), (102, 102), (302, 302)):     # each stretch starts from zero
        assert begin in rows[:, 0]
        assert k in rows[scored]


@pytest.mark.parametrize('mode', ['one_step', 'free_run'])
def test_live_gives_the_digits_of_replay(mode: str) -> None:
    predictor, data = NetworkPredictor(MODEL, make()), series()
    stepper = predictor.stepper(mode)
    live = [stepper.step(np.array([u, theta]), y) for u, theta, y in zip(
        data['u_m'], data['theta_d'], data['T_g'], strict=True)]
    np.testing.assert_array_equal(live, getattr(predictor, mode)(data))


def test_one_step_is_the_network_on_the_regressors() -> None:
    from hydro_twin.fitting.regression import regressors
    data = series()
    rows = np.concatenate(list(regressors(data, 'T_g', ['u_m', 'theta_d'], 4)))[:, :-1]
    first = np.concatenate([data['T_g'][3::-1], data['u_m'][4::-1], data['theta_d'][4::-1]])
    predicted = NetworkPredictor(MODEL, make()).one_step(data)
    assert np.isnan(predicted[:4]).all()
    np.testing.assert_allclose(predicted[4:], by_hand(make(), np.vstack([first, rows])),
                               rtol=1e-10)


def test_a_free_run_uses_the_first_sample_only() -> None:
    predictor, data = NetworkPredictor(MODEL, make()), series()
    other = np.r_[data['T_g'][:1], np.full(len(data) - 1, 7.0)]
    changed = replace(data, columns={**data.columns, 'T_g': other})
    np.testing.assert_array_equal(predictor.free_run(data), predictor.free_run(changed))


def test_survives_its_file(tmp_path: Path) -> None:
    (tmp_path / 'net.safetensors').write_bytes(network_bytes(make()))
    loaded = load_network(tmp_path / 'net.safetensors')
    assert isinstance(loaded, Recurrent)
    rows = np.random.default_rng(5).normal(size=(9, R))
    assert loaded(rows).tolist() == make()(rows).tolist()
    write_model(MODEL, tmp_path / 'model.yaml')
    np.testing.assert_array_equal(load_predictor(tmp_path / 'model.yaml').one_step(series()),
                                  NetworkPredictor(MODEL, make()).one_step(series()))


@pytest.mark.parametrize('mode', ['one_step', 'free_run'])
def test_the_live_twin_compiles_it_before_it_runs_it(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    from hydro_twin.live.models import choices, load_twin
    from hydro_twin.predictors import recurrent
    (tmp_path / 'net.safetensors').write_bytes(network_bytes(make()))
    write_model(MODEL, tmp_path / 'model.yaml')
    steps, advance = [], recurrent.advance
    monkeypatch.setattr(recurrent, 'advance', lambda *a: steps.append(0) or advance(*a))
    twin = load_twin(choices(str(tmp_path / 'model.yaml'), [])[0], mode)
    assert steps
    data = series()
    live = [twin.step(k, np.array([u, theta]), y) for k, (u, theta, y) in enumerate(zip(
        data['u_m'], data['theta_d'], data['T_g'], strict=True))]
    np.testing.assert_array_equal(live, getattr(NetworkPredictor(MODEL, make()), mode)(data))


def test_refuses_what_does_not_belong_together() -> None:
    with pytest.raises(ModelError, match='do not make layers'):
        replace(make(), weights=np.zeros(3))
    with pytest.raises(ModelError, match='kind mlp has no gru network'):
        NetworkPredictor(replace(MODEL, kind='mlp'), make())
    mlp = Network(np.array([R, 2, 1]), np.zeros(33), np.zeros(R), np.ones(R), 1.0, 1.0)
    with pytest.raises(ModelError, match='kind gru has no tanh network'):
        NetworkPredictor(MODEL, mlp)
