"""What another installed package brings, by its entry points."""
import json
import os
from pathlib import Path
import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from safetensors.numpy import load_file

from hydro_twin.plants import PLANTS
from hydro_twin.recording.rig import read, rig_of
from hydro_twin.recording.series import split

ROOT = Path(__file__).resolve().parents[1]
# The flow that leaks at the pressure at which it is all that the valve lets in.
PRESSURE = (3e-4 * 0.5 + 3e-11 * 1e6) / 6e-11       # K u = L p + slope (p - opens)
CODE = """
import sys
import numpy as np
from hydro_twin.effects import EFFECTS
from hydro_twin.model import place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.system import assemble
plant = PLANTS['accumulator']
values = {'tau': 0.03, 'K': 3e-4, 'C': 3e-12, 'L': 3e-11}
knee = place('knee', 'leakage', {'opens': 1e6, 'slope': 3e-11}, plant)
if sys.argv[1:]:
    pressure = float(sys.argv[1])
    print(knee.effect.law(values['L'] * pressure, [pressure], knee.values, [], 0.0, 0.0, []))
else:
    print(assemble(plant, values, [knee]).run(np.full((2000, 1), 0.5), np.zeros(2))[-1])
"""

# Steps a model as the node does, and prints its predictions.
LIVE = """
import json, math, sys
from pathlib import Path
import numpy as np
from hydro_twin.live.models import Choice, load_twin
twin = load_twin(Choice('', Path(sys.argv[1])), 'one_step')
found = [twin.step(k, np.zeros(2), y) for k, y in enumerate([1.0, 3.0, 2.0])]
print(json.dumps([y if math.isfinite(y) else None for y in found]))
"""


@pytest.fixture(scope='module')
def cache(tmp_path_factory):
    """Make a folder for what is compiled with the effect of the package."""
    return tmp_path_factory.mktemp('cache')


@pytest.fixture
def installed(tmp_path, cache):
    """Lay out the examples of docs/adding.md as a package of their own, as pip would."""
    package, about = tmp_path / 'oil_lab', tmp_path / 'oil_lab-1.0.dist-info'
    package.mkdir()
    about.mkdir()
    (package / '__init__.py').touch()
    page = (ROOT / 'docs' / 'adding.md').read_text(encoding='utf-8')
    for path, text in re.findall(r'```python\n# (hydro_twin/\S+)\n(.*?)```', page, re.DOTALL):
        (package / Path(path).name).write_text(text, encoding='utf-8')
    (package / 'config').mkdir()
    (package / 'config' / 'accumulator.yaml').write_text(
        re.search(r'```yaml\n# config/accumulator.yaml\n(.*?)```', page, re.DOTALL)[1])
    (about / 'METADATA').write_text('Metadata-Version: 2.1\nName: oil-lab\nVersion: 1.0\n')
    groups = tomllib.loads(re.search(r'```toml\n(.*?)```', page, re.DOTALL)[1])
    (about / 'entry_points.txt').write_text('\n'.join(
        f'[{group}]\n' + '\n'.join(f'{name} = {value}' for name, value in entries.items())
        for group, entries in groups['project']['entry-points'].items()))

    def run(*arguments, without=None, **environment):
        if without:
            text = (about / 'entry_points.txt').read_text()
            (about / 'entry_points.txt').write_text(text.replace(without, 'others'))
        return subprocess.run(
            [sys.executable, *map(str, arguments)], text=True, check=False, capture_output=True,
            env={**os.environ, 'PYTHONPATH': f'{ROOT}:{tmp_path}',
                 'XDG_CACHE_HOME': str(cache), **environment})

    return run


def test_a_package_brings_a_plant_and_an_effect(installed):
    """Without compiling, which the slow one does."""
    done = installed('-c', CODE, PRESSURE, NUMBA_DISABLE_JIT='1')
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(3e-4 * 0.5, rel=1e-12)


@pytest.mark.slow
def test_an_effect_of_a_package_is_compiled_and_comes_to_rest(installed):
    done = installed('-c', CODE)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(PRESSURE, rel=1e-6)


@pytest.mark.slow
def test_the_signals_of_a_plant_of_a_package_are_where_the_package_says(installed, tmp_path):
    """Without a file of ours: also where a file of the user's says it."""
    code = """
import sys
from pathlib import Path
from hydro_twin.recording.signals import load_signals
for config in (None, *map(Path, sys.argv[1:])):
    print(*(where.topic for where in load_signals('accumulator', ['command', 'pressure'],
                                                  config).values()))
"""
    own = tmp_path / 'rig.yaml'
    config = tmp_path / 'oil_lab' / 'config' / 'accumulator.yaml'
    own.write_text(config.read_text().replace('/accumulator/', '/rig/'))
    done = installed('-c', code, own)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ['/accumulator/command /accumulator/pressure',
                                        '/rig/command /rig/pressure']
    config.unlink()
    done = installed('-c', 'from hydro_twin.commands.main import main; main()', 'simulate',
                     '--plant', 'accumulator', '--config', own, '-o', tmp_path / 'bag',
                     '--duration', '1', NUMBA_DISABLE_JIT='1')
    assert done.returncode == 0, done.stderr
    assert (tmp_path / 'bag').is_dir()


def command(*arguments):
    return ('-m', 'hydro_twin.commands.main', *arguments)


@pytest.mark.slow
def test_a_package_brings_a_predictor(installed, tmp_path):
    model = tmp_path / 'm.yaml'
    # With what is compiled already, which a further effect would not allow.
    about = tmp_path / 'oil_lab-1.0.dist-info' / 'entry_points.txt'
    about.write_text(about.read_text().replace('hydro_twin.effects', 'others'))
    usual = {'XDG_CACHE_HOME': os.environ.get('XDG_CACHE_HOME', '')}
    done = installed(*command('refit', ROOT / 'bags' / 'rig_a', '--plant', 'load_simulator', '-o',
                              model, '--predictor', 'decay', '--json'), **usual)
    assert done.returncode == 0, done.stderr
    fitted = json.loads(done.stdout)
    # An independent solution of the same least squares, on the training part.
    data = read([ROOT / 'bags' / 'rig_a'], rig_of(PLANTS['load_simulator']))
    y = [series['T_g'] for series in split(data)[0].series]
    before, after = (np.concatenate([one[cut] for one in y]) for cut in
                     (slice(None, -1), slice(1, None)))
    (share,), *_ = np.linalg.lstsq(before[:, None], after)
    assert load_file(model.with_suffix('.safetensors'))['share'] == pytest.approx(share)
    assert fitted['train']['one_step'] == pytest.approx(
        np.sqrt(np.mean((after - share * before)**2)), rel=0.01)
    replay = command('replay', ROOT / 'bags' / 'rig_a', '--model', model, '--json')
    done = installed(*replay, **usual)
    assert 0.9 < json.loads(done.stdout)['one_step']['rmse'] / fitted['train']['one_step'] < 1.1
    done = installed('-c', LIVE, model, **usual)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == pytest.approx([None, share, 3.0 * share])
    done = installed(*replay, without='predictors', **usual)
    assert (done.returncode, done.stderr.count('\n')) == (2, 1)
    assert "predictor 'decay'; there are analytical, gru, hybrid, mlp" in done.stderr


def test_a_predictor_of_a_package_is_in_the_registry(installed):
    done = installed('-c', 'from hydro_twin.predictors import kinds; print(*kinds())')
    assert done.stdout.split() == ['analytical', 'gru', 'hybrid', 'mlp', 'decay']


def test_a_package_brings_a_verb(installed):
    assert 'extent' in installed(*command('--help')).stdout
    done = installed(*command('extent', ROOT / 'bags' / 'rig_a', '--plant', 'load_simulator',
                              '--json'))
    recording = read([ROOT / 'bags' / 'rig_a'], rig_of(PLANTS['load_simulator']))
    torque = np.concatenate([series['T_g'] for series in recording.series])
    assert json.loads(done.stdout)['T_g'] == [torque.min(), torque.max()]


def test_a_package_that_cannot_be_loaded_is_one_line(installed, tmp_path):
    (tmp_path / 'oil_lab' / 'accumulator.py').write_text('ACCUMULATOR = 1 / 0\n')
    done = installed('-c', 'from hydro_twin.commands.main import main; import sys\n'
                     'sys.exit(main(sys.argv[1:] or "refit x --plant cylinder -o y".split()))')
    assert (done.returncode, done.stderr.count('\n')) == (2, 1)
    assert 'oil-lab registers oil_lab.accumulator:ACCUMULATOR' in done.stderr


def test_a_plant_that_is_not_linear_is_refused(installed, tmp_path):
    path = tmp_path / 'oil_lab' / 'accumulator.py'
    path.write_text(path.read_text().replace('p.K * q - leakage', 'p.K * q * q - leakage'))
    done = installed('-c', 'import hydro_twin.plants')
    assert 'the equations of accumulator are not linear' in done.stderr
