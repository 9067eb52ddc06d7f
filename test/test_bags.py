"""The sample bags: small, silent about what their rigs lack, and fit for the README's commands."""
from __future__ import annotations

import json
from pathlib import Path

import pytest

from hydro_twin.commands.main import main

BAGS = Path(__file__).parents[1] / 'bags'
NAMES = ['load_simulator_linear', 'load_simulator_nonlinear',
         'rig_a', 'rig_b', 'rig_c', 'rig_d', 'rig_e']


def verb(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, dict[str, float]]:
    assert main([*map(str, arguments), '--json']) == 0
    result: dict[str, dict[str, float]] = json.loads(capsys.readouterr().out)
    return result


def test_together_they_are_small() -> None:
    assert sum(file.stat().st_size for name in NAMES for file in (BAGS / name).iterdir()) < 2e6


def test_readme_tells_where_each_comes_from() -> None:
    text = (BAGS / 'README.md').read_text()
    assert all(f'`{name}`' in text for name in NAMES)


@pytest.mark.parametrize(('name', 'linear'), [
    ('load_simulator_linear', True), ('load_simulator_nonlinear', False), ('rig_a', False),
    ('rig_b', False), ('rig_c', False), ('rig_d', False), ('rig_e', True)])
def test_the_linear_model_holds_where_nothing_is_missing(
    name: str, linear: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    model = tmp_path / 'model.yaml'
    result = verb(capsys, 'refit', BAGS / name, '--plant', 'load_simulator', '-o', model)
    noise = 0.7                             # at most: 40 dB of some 65 N m
    assert (result['test']['free_run'] < 1.1 * noise) == linear
    verb(capsys, 'replay', BAGS / name, '--model', model)
