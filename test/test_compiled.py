"""The cache of compiled code: one for all copies of the same sources, another for others."""
from collections.abc import Callable
import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / 'hydro_twin'
CODE = 'from hydro_twin.predictors.kernel import floor; print(floor(-1.5))'
Run = Callable[[str], str]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Make a function that compiles in a copy of the package, and returns what numba says."""
    def run_in(name: str) -> str:
        copy = tmp_path / name / 'hydro_twin'
        if not copy.exists():
            shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns('__pycache__'))
        return subprocess.run(
            [sys.executable, '-c', CODE], cwd=copy.parent, text=True, check=True,
            capture_output=True, env={**os.environ, 'NUMBA_DEBUG_CACHE': '1',
                                      'XDG_CACHE_HOME': str(tmp_path / 'cache')}).stdout

    return run_in


@pytest.mark.slow
def test_a_copy_of_the_same_sources_loads_what_another_compiled(run: Run) -> None:
    assert 'data saved' in run('checkout')
    again = run('workspace')
    assert 'data saved' not in again
    assert again.splitlines()[-1] == '-2'


@pytest.mark.slow
def test_a_source_that_another_calls_makes_it_compile_anew(run: Run, tmp_path: Path) -> None:
    assert 'data saved' in run('checkout')
    called = tmp_path / 'checkout' / 'hydro_twin' / 'effects' / 'bias.py'
    called.write_text(called.read_text() + '# edited\n')
    assert 'data saved' in run('checkout')
