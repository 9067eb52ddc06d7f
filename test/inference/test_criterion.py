"""Gains of the likelihood where an error changes slowly, and beside a slow error."""
from coloured_noise import coloured
import numpy as np
import pytest

from hydro_twin.fitting.autoregression import effective_gain
from hydro_twin.inference.criterion import whitened_gain


def test_of_white_noise_both_are_the_likelihood():
    before, after = 3.0 * coloured(0, 5000, 0.0), coloured(1, 5000, 0.0)
    expected = 5000 * np.log(before @ before / (after @ after))
    assert effective_gain([before], [after]) == pytest.approx(expected, rel=0.05)
    assert whitened_gain([before], [after]) == pytest.approx(expected, rel=0.05)


def test_a_smaller_error_that_is_rougher_gains():
    """As a stop that is met a little early, for a piston that runs on."""
    time = np.arange(4000) / 4000
    before = 30.0 * np.sin(2 * np.pi * 3.0 * time) + coloured(0, 4000, 0.9)
    after = 10.0 * np.sign(np.sin(2 * np.pi * 3.0 * time)) + coloured(0, 4000, 0.9)
    assert effective_gain([before], [after]) > 5.0
    assert whitened_gain([before], [after]) < 0.0


def test_beside_an_offset_the_gain_shows_in_what_is_fast():
    noise = coloured(0, 4000, 0.3)
    before, after = 10.0 + 2.0 * noise, 10.0 + noise
    assert effective_gain([before], [after]) < 1.0
    assert whitened_gain([before], [after]) > 1000.0
