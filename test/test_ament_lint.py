"""The linters of a ROS workspace, where they are installed."""
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('hydro_twin', 'launch', 'test', 'benchmarks', 'setup.py')


def test_flake8_of_ament_has_nothing_to_say() -> None:
    main = pytest.importorskip('ament_flake8.main')
    problems, lines = main.main_with_errors(
        argv=['--config', str(ROOT / 'setup.cfg'), *(str(ROOT / folder) for folder in FOLDERS)])
    assert problems == 0, '\n'.join(lines)


def test_the_manifest_is_of_its_schema() -> None:
    main = pytest.importorskip('ament_xmllint.main')
    assert main.main(argv=[str(ROOT / 'package.xml')]) == 0
