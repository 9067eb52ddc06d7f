"""The comparison of servos from the shell."""
import json
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.commands.main import main
from hydro_twin.studies.l18 import event


def frequency_control(*arguments: object) -> int:
    return main(['frequency-control', *map(str, arguments)])


@pytest.fixture
def short_event(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event, 'EVENT', ((0, 0.0), (1, 0.0), (2, -1.0), (25, -1.0)))


@pytest.mark.usefixtures('short_event')
def test_at_the_end_of_the_travel_the_linear_servo_goes_on(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert frequency_control('-o', tmp_path / 'out', '--load', 1.03, '--json') == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / 'out' / 'comparison.json').read_text()) == printed
    assert printed['load'] == 1.03
    assert printed['steady']['nonlinear']['opening'] == pytest.approx(1.05)
    assert printed['steady']['linear']['opening'] == pytest.approx(1.09, abs=5e-3)
    assert printed['agreement']['linear']['opening']['relative_error_percent'] > 3
    assert (tmp_path / 'out' / 'comparison.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.slow
@pytest.mark.usefixtures('short_event')
def test_by_default_the_powers_are_those_of_figure_13(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert frequency_control('-o', tmp_path / 'out', '--json') == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed['load'] == 0.89
    for servo in printed['steady'].values():
        assert servo['power'] == pytest.approx(0.95, abs=5e-3)      # 25 s after rest
        assert 0.68 < servo['opening'] < 0.84


@pytest.mark.parametrize('load', [-0.1, 1.2, 'nan'])
def test_a_load_beyond_the_curve_is_refused(
        load: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert frequency_control('-o', tmp_path / 'out', f'--load={load}') == 2
    error = capsys.readouterr().err
    assert 'does not reach the power' in error
    assert error.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_the_file_of_constants_repeats_the_defaults() -> None:
    defaults = {constant.name: constant.value for constant in event.CONSTANTS}
    assert event.load_loop_constants() == defaults


@pytest.mark.parametrize(('line', 'says'), [
    ('T_RX: 5.0', "no constant 'T_RX'"),
    ('T_RH: fast', 'must be a finite number'),
    ('T_RH: -1.0', 'must be above zero'),
])
def test_bad_constants_are_refused_in_one_line(
        tmp_path: Path, line: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / 'config.yaml'
    config.write_text(f'/**:\n  ros__parameters:\n    constants:\n      {line}\n')
    assert frequency_control('-o', tmp_path / 'out', '--config', config) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_a_bag_that_is_not_there_is_refused(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert frequency_control(tmp_path / 'none', '-o', tmp_path / 'out') == 2
    assert 'no such bag' in capsys.readouterr().err


def test_the_event_falls_as_said() -> None:
    course = event.simulated_frequency(50.0, 0.01)
    assert course[0] == 50.0
    assert course[-1] == pytest.approx(49.8)
    assert np.all(np.diff(course) <= 0)
