"""A plant and an effect that another installed package brings, by its entry points."""
import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
CODE = """
import numpy as np
from hydro_twin.effects import EFFECTS
from hydro_twin.model import place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.system import assemble
plant = PLANTS['accumulator']
values = {'tau': 0.03, 'K': 3e-4, 'C': 3e-12, 'L': 3e-11}
knee = place('knee', 'leakage', {'opens': 1e6, 'slope': 3e-11}, plant)
print(assemble(plant, values, [knee]).run(np.full((2000, 1), 0.5), np.zeros(2))[-1])
"""


@pytest.fixture
def installed(tmp_path):
    """Lay out the two examples of docs/adding.md as a package of their own, as pip would."""
    package, about = tmp_path / 'oil_lab', tmp_path / 'oil_lab-1.0.dist-info'
    package.mkdir()
    about.mkdir()
    (package / '__init__.py').touch()
    page = (ROOT / 'docs' / 'adding.md').read_text(encoding='utf-8')
    for path, text in re.findall(r'```python\n# (hydro_twin/\S+)\n(.*?)```', page, re.DOTALL):
        (package / Path(path).name).write_text(text, encoding='utf-8')
    (about / 'METADATA').write_text('Metadata-Version: 2.1\nName: oil-lab\nVersion: 1.0\n')
    (about / 'entry_points.txt').write_text(
        '[hydro_twin.plants]\naccumulator = oil_lab.accumulator:ACCUMULATOR\n'
        '[hydro_twin.effects]\nknee = oil_lab.knee\n')

    def run(code):
        return subprocess.run(
            [sys.executable, '-c', code], text=True, check=False, capture_output=True,
            env={**os.environ, 'PYTHONPATH': f'{ROOT}:{tmp_path}',
                 'XDG_CACHE_HOME': str(tmp_path)})

    return run


def test_a_package_brings_a_plant_and_an_effect(installed):
    done = installed(CODE)
    assert done.returncode == 0, done.stderr
    # Steady state: K u = L p + slope (p - opens).
    assert float(done.stdout) == pytest.approx((3e-4 * 0.5 + 3e-11 * 1e6) / 6e-11, rel=1e-6)


def test_a_package_that_cannot_be_loaded_is_one_line(installed, tmp_path):
    (tmp_path / 'oil_lab' / 'accumulator.py').write_text('ACCUMULATOR = 1 / 0\n')
    done = installed('from hydro_twin.commands.main import main; import sys\n'
                     'sys.exit(main(sys.argv[1:] or "refit x --plant cylinder -o y".split()))')
    assert (done.returncode, done.stderr.count('\n')) == (2, 1)
    assert 'oil-lab registers oil_lab.accumulator:ACCUMULATOR' in done.stderr


def test_a_plant_that_is_not_linear_is_refused(installed, tmp_path):
    path = tmp_path / 'oil_lab' / 'accumulator.py'
    path.write_text(path.read_text().replace('p.K * q - leakage', 'p.K * q * q - leakage'))
    done = installed('import hydro_twin.plants')
    assert 'the equations of accumulator are not linear' in done.stderr
