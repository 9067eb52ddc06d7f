"""No law reads or writes beyond the arrays that it is given."""
from dataclasses import replace
import os
from pathlib import Path
import subprocess
import sys

import pytest

from hydro_twin.effects import EFFECTS, Placed
from hydro_twin.effects.curve import of_kind
from hydro_twin.plants import PLANTS

HERE = Path(__file__).parent
MOTOR = next(port for port in PLANTS['load_simulator'].ports if port.kind == 'force')
FRICTION = next(effect for effect in EFFECTS if effect.id == 'friction')


@pytest.mark.parametrize('values', [(), (1.0,) * 4, (1.0,) * 6])
def test_an_effect_takes_as_many_values_as_it_has_parameters(values):
    with pytest.raises(ValueError, match=f'friction takes 5 values, not {len(values)}'):
        Placed(FRICTION, MOTOR, values)
    placed = Placed(FRICTION, MOTOR, (1.0,) * 5)
    with pytest.raises(ValueError, match='takes 5 values'):
        replace(placed, values=values)


def test_an_effect_sits_where_its_signals_are():
    with pytest.raises(ValueError, match='reads the twist, of which the motor has none'):
        Placed(of_kind(MOTOR.kind, 'twist'), MOTOR, (0.0,) * 11)
    Placed(of_kind(MOTOR.kind, 'value'), MOTOR, (0.0,) * 11)


@pytest.mark.parametrize('reads', [('velocity', 'position', 'value'), ()])
def test_a_law_reads_two_signals_at_most_and_an_implicit_one_at_least_one(reads):
    with pytest.raises(ValueError, match='two signals at most, an implicit one at least one'):
        replace(FRICTION, reads=reads)


def checked(*arguments, cache):
    """Run Python with every access to an array checked, in a cache of its own."""
    return subprocess.run(
        [sys.executable, *arguments], text=True, capture_output=True, check=False,
        env={**os.environ, 'NUMBA_BOUNDSCHECK': '1', 'XDG_CACHE_HOME': str(cache)})


@pytest.mark.slow
def test_laws_stay_within_their_arrays(tmp_path):
    done = checked('-m', 'pytest', '-q', '-p', 'no:cacheprovider', '-k', 'not halving',
                   str(HERE / 'test_effect_laws.py'), str(HERE / 'test_effects_in_plants.py'),
                   str(HERE / 'test_curve.py'), cache=tmp_path)
    assert done.returncode == 0, done.stdout[-3000:]
    # And accesses are checked indeed.
    code = ('import numpy as np; from hydro_twin.effects.friction import law; '
            'law(0.0, np.zeros(2), np.ones(4), np.zeros(2), 0.1, 1.0, np.zeros(2))')
    assert 'IndexError' in checked('-c', code, cache=tmp_path).stderr
