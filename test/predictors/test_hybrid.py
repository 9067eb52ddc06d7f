"""The MLP and the hybrid as predictors: one step, free run, live and from a file."""
from __future__ import annotations

from dataclasses import replace
import logging
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.errors import ModelError
from hydro_twin.model import load_predictor, Model, place, write_model
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.plants.positioning import POSITIONING
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.network import Network, network_bytes
from hydro_twin.predictors.network_predictor import NetworkPredictor
from hydro_twin.recording.series import Series

N = 400


def network(scale: float = 1.0, seed: int = 0) -> Network:
    rng = np.random.default_rng(seed)
    sizes = np.array([14, 7, 1])
    return Network(sizes, rng.normal(0, 0.2, 15 * 7 + 8), np.zeros(14), np.full(14, 30.0),
                   scale, 1e4)


def model(kind: str, **more: object) -> Model:
    middle = {p.name: (p.lower + p.upper) / 2 for p in LOAD_SIMULATOR.parameters}
    values = LOAD_SIMULATOR.constant_values() | ({} if kind == 'mlp' else middle)
    return Model(LOAD_SIMULATOR, values, 0.002, kind=kind, **more)  # type: ignore[arg-type]


def with_dead_zone() -> Model:
    placed = place('dead_zone', 'spool', {'centre': 0.0, 'width': 4e-5}, LOAD_SIMULATOR)
    return replace(model('hybrid'), effects=(placed,))


def series() -> Series:
    t = 0.002 * np.arange(N)
    rng = np.random.default_rng(1)
    return Series({'u_m': np.sin(9 * t), 'theta_d': 1e-3 * np.cos(20 * t),
                   'T_g': 30.0 * np.sin(9 * t - 0.4) + rng.normal(size=N)}, 0.002)


def measured(**columns: object) -> Series:
    return replace(series(), columns={**series().columns, **columns})


def test_the_mlp_uses_the_regressors_of_the_paper() -> None:
    mlp, data = NetworkPredictor(model('mlp'), network()), series()
    predicted = mlp.one_step(data)
    assert np.isnan(predicted[:4]).all()
    for k in (4, 50, N - 1):
        row = np.concatenate([data['T_g'][k - 4:k][::-1], data['u_m'][k - 4:k + 1][::-1],
                              data['theta_d'][k - 4:k + 1][::-1]])
        assert predicted[k] == mlp.network(row[None])[0]


@pytest.mark.parametrize('made', [model('hybrid'), with_dead_zone()])
def test_the_hybrid_adds_to_the_analytical_one_step(made: Model) -> None:
    hybrid, data = NetworkPredictor(made, network()), series()
    mlp = NetworkPredictor(model('mlp'), network())
    np.testing.assert_allclose(hybrid.one_step(data)[4:],
                               Analytical(made).one_step(data)[4:] + mlp.one_step(data)[4:],
                               rtol=1e-12)


@pytest.mark.parametrize('made', [model('mlp'), model('hybrid'), with_dead_zone()])
def test_a_free_run_uses_no_measured_output_after_the_first(made: Model) -> None:
    predictor = NetworkPredictor(made, network())
    predicted = predictor.free_run(series())
    assert np.isfinite(predicted).all()
    other = predictor.free_run(measured(T_g=np.r_[series()['T_g'][0], np.full(N - 1, np.nan)]))
    np.testing.assert_array_equal(predicted, other)


@pytest.mark.parametrize('made', [model('mlp'), model('hybrid')])
def test_a_free_run_is_one_step_on_its_own_output(made: Model) -> None:
    predictor = NetworkPredictor(made, network())
    predicted = predictor.free_run(series())
    one_step = predictor.one_step(measured(T_g=predicted))
    np.testing.assert_allclose(one_step[4:], predicted[4:], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('made', [model('mlp'), model('hybrid')])
def test_a_free_run_starts_from_zero_without_a_sensor(made: Model) -> None:
    predictor = NetworkPredictor(made, network())
    blind = predictor.free_run(measured(T_g=np.full(N, np.nan)))
    assert np.isfinite(blind).all()
    np.testing.assert_array_equal(blind, predictor.free_run(measured(T_g=np.zeros(N))))


@pytest.mark.parametrize('made', [model('mlp'), model('hybrid')])
def test_a_sample_that_is_not_measured_counts_as_predicted(made: Model) -> None:
    predictor = NetworkPredictor(made, network())
    gap = series()['T_g'].copy()
    gap[30] = np.nan
    predicted = predictor.one_step(measured(T_g=gap))
    gap[30] = predicted[30]
    filled = predictor.one_step(measured(T_g=gap))
    np.testing.assert_allclose(predicted[4:], filled[4:], rtol=1e-9)


def test_a_network_of_nothing_leaves_the_analytical_model() -> None:
    nothing = replace(network(), weights=np.zeros(15 * 7 + 8))
    made = model('hybrid')
    np.testing.assert_array_equal(NetworkPredictor(made, nothing).one_step(series()),
                                  Analytical(made).one_step(series()))


def test_a_diverging_free_run_stops_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    # one linear layer, y(k) = 2 y(k-1): from 1 beyond 100 at the seventh step
    growing = Network(np.array([14, 1]), np.r_[2.0, np.zeros(14)], np.zeros(14), np.ones(14),
                      1.0, 100.0)
    with caplog.at_level(logging.WARNING):
        predicted = NetworkPredictor(model('mlp'), growing).free_run(measured(T_g=np.ones(N)))
    assert predicted[:6].tolist() == [2.0, 4.0, 8.0, 16.0, 32.0, 64.0]
    assert np.isnan(predicted[6:]).all()
    assert 'diverges after 0.012 s' in caplog.text


@pytest.mark.parametrize('kind', ['mlp', 'hybrid'])
def test_survives_its_files(tmp_path: Path, kind: str) -> None:
    (tmp_path / 'net.safetensors').write_bytes(network_bytes(network()))
    write_model(model(kind, network='net.safetensors'), tmp_path / 'model.yaml')
    loaded = load_predictor(tmp_path / 'model.yaml')
    np.testing.assert_array_equal(
        loaded.one_step(series()), NetworkPredictor(model(kind), network()).one_step(series()))


def test_refuses_weights_of_another_plant_or_none(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match='14 regressors, but positioning has 5'):
        NetworkPredictor(replace(model('mlp'), plant=POSITIONING), network())
    write_model(model('mlp'), tmp_path / 'model.yaml')
    with pytest.raises(ModelError, match='must name its network'):
        load_predictor(tmp_path / 'model.yaml')


def test_names_weights_that_were_left_behind(tmp_path: Path) -> None:
    (tmp_path / 'copied').mkdir()
    copy = tmp_path / 'copied' / 'model.yaml'
    write_model(model('mlp', network='net.safetensors'), copy)
    with pytest.raises(ModelError) as caught:
        load_predictor(copy)
    assert str(caught.value) == (f'{copy}: its weights file net.safetensors is missing: copy it '
                                 f'to the folder of the model, {copy.parent}')
