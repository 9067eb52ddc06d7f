"""The effect and the plant of docs/adding.md, put into a copy of the package."""
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope='module')
def copy(tmp_path_factory):
    """Make a copy of the package with what the page adds; a function that runs code in it."""
    folder = tmp_path_factory.mktemp('added')
    for name in ('hydro_twin', 'config'):
        shutil.copytree(ROOT / name, folder / name,
                        ignore=shutil.ignore_patterns('__pycache__'))
    shutil.copy(ROOT / 'package.xml', folder)      # tells a source tree
    page = (ROOT / 'docs' / 'adding.md').read_text(encoding='utf-8')
    for path, text in re.findall(r'```\w+\n# (\S+)\n(.*?)```', page, re.DOTALL):
        (folder / path).write_text(text, encoding='utf-8')

    def run(*arguments):
        return subprocess.run(
            [sys.executable, *map(str, arguments)], cwd=folder, text=True, check=True,
            capture_output=True,
            env={**os.environ, 'PYTHONPATH': str(folder), 'XDG_CACHE_HOME': str(folder)}).stdout

    return run


@pytest.mark.slow
def test_a_file_is_all_that_an_effect_takes(copy):
    code = """
import numpy as np
from hydro_twin.effects import EFFECTS
from hydro_twin.model import place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.system import assemble
import hydro_twin

plant = PLANTS['load_simulator']
values = plant.constant_values() | {p.name: (p.lower * p.upper) ** 0.5 for p in plant.parameters}
knee = place('knee', 'leakage', {'opens': 1e6, 'slope': 1e-11}, plant)
inputs = np.column_stack([np.full(2000, 0.3), np.zeros(2000)])
torque = assemble(plant, values, [knee]).run(inputs, np.zeros(4))[-1]
print(hydro_twin.__file__)
print(len(EFFECTS), torque)
"""
    file, numbers = copy('-c', code).splitlines()
    assert ROOT not in Path(file).parents
    found = float(numbers.split()[1])
    # Steady state: K_q K_sv u = K_ce p + slope (p - opens), torque D_m p.
    K_q, K_sv, K_ce = ((a * b) ** 0.5 for a, b in ((0.2, 2.5), (3e-5, 2e-4), (1e-12, 1e-11)))
    pressure = (K_q * K_sv * 0.3 + 1e-11 * 1e6) / (K_ce + 1e-11)
    assert found == pytest.approx(2e-5 * pressure, rel=1e-4)


@pytest.mark.slow
def test_the_plant_is_simulated_and_traced_to_the_effect(copy, tmp_path):
    copy('-m', 'hydro_twin.commands.main', 'simulate', '--plant', 'accumulator',
         '-o', tmp_path / 'bag', '--effect', 'knee@leakage:opens=3e6,slope=1e-10', '--snr', 40,
         '--excitation', 'command=multisine')
    report = json.loads(copy('-m', 'hydro_twin.commands.main', 'trace', tmp_path / 'bag',
                             '--plant', 'accumulator', '-o', tmp_path / 'out', '--json'))
    (found,) = report['effects']
    assert (found['id'], found['port']) == ('knee', 'leakage')
    # Flows are known up to the capacity, which this recording cannot tell.
    opens = found['parameters']['opens']
    assert opens['value'] == pytest.approx(3e6, rel=0.05)
    assert opens['unit'] == 'Pa'
    assert report['after']['free_run']['test'] < 0.3 * report['before']['free_run']['test']
