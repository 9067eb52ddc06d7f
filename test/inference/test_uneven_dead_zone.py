"""A valve whose overlap differs up and down, as most real ones do."""
import numpy as np
import pytest

from hydro_twin.inference.trace import trace
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series

PLANT, T, NOISE = plant_named('cylinder'), 0.05, 2e-4
ZONE = {'width': 1.2, 'centre': -0.7}


def moved_by_hand(seed):
    """Two series of a cylinder under manual control, 20 samples a second."""
    rng = np.random.default_rng(seed)
    values = PLANT.constant_values() | {'K_v': 0.02, 'tau': 0.1}
    system = Model(PLANT, values, T, (place('dead_zone', 'command', ZONE, PLANT),)).system
    series = []
    for k in range(2):
        levels = rng.uniform(-2.5, 2.5, 60) * (rng.random(60) < 0.7)
        command = np.convolve(np.repeat(levels, 20), np.full(10, 0.1), 'same')
        x = system.run(command[:, None], np.zeros(PLANT.order))
        series.append(Series({'command': command, 'x': x + NOISE * rng.standard_normal(len(x))},
                             T, start=k * 10**12, source='rig'))
    return Recording(tuple(series))


@pytest.mark.slow
def test_its_edges_are_found_where_no_zone_about_the_middle_helps():
    found = trace(moved_by_hand(1), None, PLANT)
    effect, = found.effects
    assert (effect.id, effect.port) == ('dead_zone', 'command')
    assert effect.placed.named['width'] == pytest.approx(ZONE['width'], rel=0.02)
    assert effect.placed.named['centre'] == pytest.approx(ZONE['centre'], rel=0.02)
    assert found.after.errors['after']['horizon']['test'] < 1.05 * NOISE
