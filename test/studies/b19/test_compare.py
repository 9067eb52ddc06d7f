"""The whole study, end to end, on a small recording; and what it refuses."""
from __future__ import annotations

from functools import partial
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydro_twin.commands.main import main
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.recording.series import Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording

T = 0.002
TRUE = {'V_m': 1.75e-4, 'J': 5.5e-2, 'K_p': 1.75e-2, 'K_q': 1.35, 'G': 1.1e4, 'K_ce': 5.5e-12,
        'B_m': 55.0, 'K_sv': 1.15e-4, 'beta_e': 7e8, 'D_m': 2e-5}


def recorded(hertz: float, samples: int, start: int) -> Series:
    """Record the five laws with Coulomb friction, integrated by scipy, and a little noise."""
    laws = LOAD_SIMULATOR.laws(TRUE)

    def inputs(time: float) -> np.ndarray:
        return np.array([0.4 * np.sin(2 * np.pi * hertz * time),
                         1e-3 * np.sin(3 * np.pi * hertz * time + 1.0)])

    def slope(time: float, x: np.ndarray) -> np.ndarray:
        moved: np.ndarray = laws.A @ x + laws.B @ inputs(time)
        moved[2] -= 10.0 * np.tanh(x[2] / 0.02) / TRUE['J']
        return moved

    times = T * np.arange(samples)
    x = solve_ivp(slope, (0.0, times[-1]), np.zeros(4), 'BDF', times, rtol=1e-6, atol=1e-10).y
    u, theta = np.array([inputs(time) for time in times]).T
    torque = TRUE['G'] * (x[3] - theta) + np.random.default_rng(0).normal(0, 0.3, samples)
    return Series({'u_m': u, 'theta_d': theta, 'T_g': torque}, T, start)


def bag(path: Path, samples: int) -> Path:
    signals = load_signals('load_simulator', [s.name for s in LOAD_SIMULATOR.signals])
    write_recording(path, [recorded(hertz, samples, int(1e11) * (i + 1))
                           for i, hertz in enumerate((3.0, 9.0))], signals)
    return path


@pytest.fixture(scope='module')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag(tmp_path_factory.mktemp('compare') / 'bag', 450)


def compare(bag: Path, out: Path, *more: str) -> int:
    return main(['compare', str(bag), '--plant', 'load_simulator', '-o', str(out), *more])


@pytest.mark.slow
def test_compares_everything(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip('torch')
    out = tmp_path / 'out'
    assert compare(recording, out, '--runs', '3', '--json') == 0
    result = json.loads(capsys.readouterr().out)
    assert json.loads((out / 'comparison.json').read_text())['experiments'] == (
        result['experiments'])
    assert (out / 'comparison.html').stat().st_size > 10_000
    for experiment in result['experiments'].values():
        methods = experiment['methods']
        assert list(methods) == ['random', 'ea', 'bees', 'pso', 'mlp', 'hybrid', 'least_squares']
        train = {name: found['runs']['train']['one_step'] for name, found in methods.items()}
        assert all(len(errors) == 3 for errors in train.values())
        linear = [error for name in ('random', 'ea', 'bees', 'pso') for error in train[name]]
        assert max(train['least_squares']) <= min(linear) * (1 + 1e-9)
        assert experiment['unconstrained']['train'] <= min(train['least_squares'])
        assert max(train['hybrid']) < min(train['least_squares'])
        assert len(set(train['mlp'])) == 3          # seeds differ
        assert len(methods['mlp']['curve']['median']) == 500
    direct, swapped = result['experiments']['direct'], result['experiments']['swapped']
    assert direct['patterns'] == {'train': 2 * 295, 'test': 2 * 145}
    assert swapped['patterns'] == {'train': 2 * 145, 'test': 2 * 295}


@pytest.mark.slow
def test_searches_the_settings_on_the_training_part(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip('torch')
    from hydro_twin.fitting.network_search import search
    monkeypatch.setattr('hydro_twin.studies.b19.settings.search', partial(
        search, decays=(0.0,), structures=((1,), (4,)), repeats=2))
    out = tmp_path / 'out'
    assert compare(recording, out, '--runs', '1', '--search', '--json') == 0
    settings = json.loads(capsys.readouterr().out)['settings']
    assert settings['direct']['mlp']['hidden'] in ([1], [4])
    logs = sorted(file.name for file in out.glob('*.jsonl'))
    assert logs == [f'{name}.{kind}.search.jsonl' for name in ('direct', 'swapped')
                    for kind in ('hybrid', 'mlp')]
    # Each looks at its own training part: the same patterns would make the same head.
    assert len({(out / log).read_text().splitlines()[0] for log in logs}) == 4


def test_refuses_a_recording_that_is_too_short(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip('torch')
    assert compare(bag(tmp_path / 'bag', 60), tmp_path / 'out') == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert 'training part: no series is long enough' in said
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize(('more', 'says'), [
    (['--runs', '0'], 'at least one run'),
    (['-o', __file__], 'is not a folder'),
])
def test_refuses_wrong_arguments(
    more: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    assert compare(tmp_path / 'none', tmp_path / 'out', *more) == 2
    assert says in capsys.readouterr().err
