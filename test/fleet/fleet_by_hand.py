"""Small fleets: recordings of a process valve, traced in a second each, and made-up results."""
import numpy as np

from hydro_twin.commands.main import main
from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.task import Outcome

PLANT = 'control_valve'


def record(folder, name, seed, *more):
    """Simulate a bag of 200 samples."""
    assert main(['simulate', '--plant', PLANT, '--noise', '5e-3', '--duration', '200',
                 '--excitation', 'command=steps', '--seed', str(seed), *more, '-o',
                 str(folder / name)]) == 0


def broken(folder, name):
    """Make a bag that cannot be read."""
    (folder / name).mkdir()
    (folder / name / 'metadata.yaml').write_text('no bag', 'utf-8')


def manifest(folder, rows, name='fleet.csv', columns='name,plant,bags,date'):
    """Write a manifest; returns its path."""
    (folder / name).write_text('\n'.join([columns, *rows]) + '\n', 'utf-8')
    return folder / name


def outcome(estimates, effects=(), verdict='effect_found'):
    """Make what a trace would come to.

    estimates: name -> (value, standard error); effects: the probability of each.
    """
    return Outcome({
        'verdict': verdict, 'says': 'It <lacks> something.', 'noise': 1e-3, 'unit': '1',
        'error': {'before': 2e-3, 'after': 1e-3}, 'nothing': 0.875, 'law_unknown': 0.004,
        'effects': [{'id': 'backlash', 'port': 'stem', 'certain': True, 'p_value': 0.0,
                     'probability': one, 'share_of_residual': 0.9} for one in effects],
        'estimates': {name: {'value': value, 'std_error': error, 'unit': 's'}
                      for name, (value, error) in estimates.items()},
        'factor': {'names': list(estimates), 'values': [value for value, _ in estimates.values()],
                   'rows': np.diag([1.0 / error for _, error in estimates.values()]).tolist(),
                   'step': [0.0] * len(estimates)},
        'samples': 200, 'bags': [], 'version': '0', 'seconds': 1.0}, key='0' * 32, traced=True)


def task(rig, date='2026-01-01', group='a', **labels):
    return Task(rig, PLANT, (), date, False, None, (), group, tuple(labels.items()))
