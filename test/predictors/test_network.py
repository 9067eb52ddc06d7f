"""The compiled prediction against plain numpy and torch, one by one and in a batch."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.errors import ModelError
from hydro_twin.predictors.network import Network, network_bytes
from hydro_twin.predictors.network_predictor import load_network


def make(*hidden: int, seed: int = 0, regressors: int = 14) -> Network:
    rng = np.random.default_rng(seed)
    sizes = np.array([regressors, *hidden, 1])
    return Network(sizes, rng.normal(0, 0.2, int(np.sum((sizes[:-1] + 1) * sizes[1:]))),
                   rng.normal(size=regressors), rng.uniform(0.5, 2.0, regressors), 200.0, 1e4)


@pytest.mark.parametrize('hidden', [(77, 77), (80,), (3, 50, 7)])
def test_is_the_textbook_formula(hidden: tuple[int, ...]) -> None:
    network = make(*hidden)
    x = np.random.default_rng(2).normal(size=(50, 14))
    layer, begin = (x - network.shift) / network.scale, 0
    for rows, columns in zip(network.sizes, network.sizes[1:], strict=False):
        end = begin + rows * columns
        layer = (layer @ network.weights[begin:end].reshape(rows, columns)
                 + network.weights[end:end + columns])
        layer = np.tanh(layer) if columns > 1 else layer
        begin = end + columns
    np.testing.assert_allclose(network(x), 200.0 * layer[:, 0], rtol=1e-12, atol=1e-12)


def test_agrees_with_torch() -> None:
    torch = pytest.importorskip('torch')
    network = make(77, 77)
    modules, begin = [], 0
    for rows, columns in zip(network.sizes, network.sizes[1:], strict=False):
        linear, end = torch.nn.Linear(int(rows), int(columns)).double(), begin + rows * columns
        linear.weight.data = torch.tensor(network.weights[begin:end].reshape(rows, columns).T)
        linear.bias.data = torch.tensor(network.weights[end:end + columns])
        modules += [linear, torch.nn.Tanh()]
        begin = end + columns
    model = torch.nn.Sequential(*modules[:-1])
    x = np.random.default_rng(3).normal(size=(200, 14))
    scaled = torch.tensor((x - network.shift) / network.scale)
    expected = 200.0 * model(scaled).detach().numpy()[:, 0]
    np.testing.assert_allclose(network(x), expected, rtol=1e-9)
    single = 200.0 * model.float()(scaled.float()).detach().numpy()[:, 0]     # as in training
    np.testing.assert_allclose(network(x), single, rtol=1e-6, atol=1e-6 * np.abs(single).max())


def test_a_batch_is_its_samples_to_the_last_digit() -> None:
    network = make(77, 77)
    x = np.random.default_rng(4).normal(size=(300, 14))
    scratch = network.scratch()
    assert network(x).tolist() == [network.predict(row, scratch) for row in x]


def test_survives_its_file(tmp_path: Path) -> None:
    network, path = make(5, 4), tmp_path / 'net.safetensors'
    path.write_bytes(network_bytes(network))
    loaded = load_network(path)
    x = np.random.default_rng(5).normal(size=(9, 14))
    assert loaded(x).tolist() == network(x).tolist()
    assert (loaded.sizes.tolist(), loaded.limit) == (network.sizes.tolist(), network.limit)


@pytest.mark.parametrize('damage', [b'', b'not a network', None])
def test_refuses_a_damaged_file(tmp_path: Path, damage: bytes | None) -> None:
    path = tmp_path / 'net.safetensors'
    if damage is None:
        damage = network_bytes(make(5))[:-8]
    path.write_bytes(damage)
    with pytest.raises(ModelError, match=r'net\.safetensors: not a network'):
        load_network(path)


def test_refuses_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match='none'):
        load_network(tmp_path / 'none.safetensors')


@pytest.mark.parametrize('change', [
    {'weights': np.zeros(3)}, {'sizes': np.array([14, 5, 2])}, {'scale': np.zeros(14)},
    {'shift': np.full(14, np.nan)}, {'limit': float('nan')},
])
def test_refuses_what_does_not_fit_together(change: dict[str, object]) -> None:
    with pytest.raises(ModelError):
        replace(make(5), **change)
