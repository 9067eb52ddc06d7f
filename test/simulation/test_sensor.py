import numpy as np
import pytest

from hydro_twin.recording.series import Series
from hydro_twin.simulation.sensor import measure

SERIES = Series({'u': np.zeros(20000), 'y': 5.0 + np.sin(np.arange(20000) / 50)}, 0.002)


def test_noise_has_the_ratio_asked_for():
    noisy, rms = measure(SERIES, 'y', 20.0, 0.0, 0.0, np.random.default_rng(0))
    added = noisy['y'] - SERIES['y']
    assert rms == pytest.approx(np.std(SERIES['y']) / 10)
    assert added.std() == pytest.approx(rms, rel=0.02)
    assert abs(np.corrcoef(added[1:], added[:-1])[0, 1]) < 0.03
    assert noisy['u'] is SERIES['u']


def test_quantisation_rounds_to_whole_steps():
    noisy, _ = measure(SERIES, 'y', None, 0.0, 0.25, np.random.default_rng(0))
    assert np.abs(noisy['y'] - SERIES['y']).max() <= 0.125
    assert not np.mod(noisy['y'], 0.25).any()


def test_without_noise_nothing_changes():
    same, rms = measure(SERIES, 'y', None, 0.0, 0.0, np.random.default_rng(0))
    assert rms == 0.0
    np.testing.assert_array_equal(same['y'], SERIES['y'])
