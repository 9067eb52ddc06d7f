"""The demonstration recordings, read back."""
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.recording.read import read_recording
from hydro_twin.recording.signals import load_signals
from hydro_twin.studies.l18 import event
from hydro_twin.studies.l18.demonstration import LOAD, main, NOISE, RESOLUTION
from hydro_twin.studies.l18.frequency_control import compare


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('bags')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(event, 'EVENT', ((0, 0.0), (2, 0.0), (3, -0.4), (40, -0.4)))
        assert main([str(path)]) == 0
    return path


def test_steps_are_as_a_plant_records_them(folder: Path) -> None:
    signals = load_signals('valve_servo', ('command', 'opening'))
    steps, = read_recording([folder / 'valve_steps'], signals, {'command'}, 0.002).series
    assert 0.002 * len(steps) == pytest.approx(8, abs=0.005)
    grains = steps['opening'] / RESOLUTION
    assert grains == pytest.approx(np.round(grains), abs=1e-6)
    rest = steps['opening'][:499]
    assert rest.mean() == pytest.approx(0, abs=1e-4)
    assert rest.std() == pytest.approx(np.hypot(NOISE, RESOLUTION / 12**0.5), rel=0.2)


def test_the_limit_is_reached(folder: Path) -> None:
    signals = load_signals('valve_servo', ('command', 'opening'))
    series, = read_recording([folder / 'valve_limit'], signals, {'command'}, 0.002).series
    assert series['command'].max() == 1.1
    assert series['opening'].max() == pytest.approx(1.05, abs=5 * NOISE)


def test_the_event_is_explained_by_the_limit(folder: Path, tmp_path: Path) -> None:
    agreement = compare(folder / 'valve_event', tmp_path)['agreement']
    linear, nonlinear = agreement['linear'], agreement['nonlinear']
    asked = LOAD + 0.06             # by the amplitude limit; the curve has slope 1 at its end
    assert linear['opening']['steady_error_percent'] == pytest.approx(
        100 * (asked - 1.05), abs=0.2)
    assert abs(nonlinear['opening']['steady_error_percent']) < 0.1
    assert nonlinear['opening']['fit_percent'] > 95 > linear['opening']['fit_percent']
    assert nonlinear['power']['fit_percent'] > linear['power']['fit_percent']


def test_nothing_is_overwritten(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(folder)]) == 2
    error = capsys.readouterr().err
    assert 'exists already' in error
    assert error.count('\n') == 1
