"""The comparison of servos from the shell."""
import json
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.studies.l18 import event
from hydro_twin.studies.l18.frequency_control import main


def test_without_a_bag_the_linear_servo_overshoots_the_limit(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(event, 'EVENT', ((0, 0.0), (1, 0.0), (2, -1.0), (25, -1.0)))
    assert main(['-o', str(tmp_path / 'out'), '--json']) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / 'out' / 'comparison.json').read_text()) == printed
    assert printed['steady']['nonlinear']['opening'] == pytest.approx(1.05)
    assert printed['steady']['linear']['opening'] > 1.09
    assert printed['agreement']['linear']['opening']['steady_error_percent'] > 4
    assert (tmp_path / 'out' / 'comparison.png').read_bytes().startswith(b'\x89PNG')


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
    assert main(['-o', str(tmp_path / 'out'), '--config', str(config)]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_a_bag_that_is_not_there_is_refused(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / 'none'), '-o', str(tmp_path / 'out')]) == 2
    assert 'no such bag' in capsys.readouterr().err


def test_the_event_falls_as_said() -> None:
    course = event.simulated_frequency(50.0, 0.01)
    assert course[0] == 50.0
    assert course[-1] == pytest.approx(49.8)
    assert np.all(np.diff(course) <= 0)
