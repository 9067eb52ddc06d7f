"""Trends: against least squares by scipy."""
import numpy as np
import pytest
from scipy.optimize import curve_fit

from hydro_twin.fleet.trend import line


def test_a_trend_is_the_line_of_least_squares():
    rng = np.random.default_rng(2)
    x, s = np.array([0.0, 0.3, 0.5, 1.0]), np.array([0.1, 0.2, 0.1, 0.3])
    y = 1.0 + 0.7 * x + s * rng.normal(size=4)
    (slope, _), known = curve_fit(lambda x, a, b: a * x + b, x, y, sigma=s, absolute_sigma=True)
    _, scaled = curve_fit(lambda x, a, b: a * x + b, x, y, sigma=s)
    found = line(x, y, s)
    assert (found.slope, found.std_error) == pytest.approx((slope, known[0, 0] ** 0.5), rel=1e-5)
    assert found.ratio == pytest.approx(scaled[0, 0] / known[0, 0], rel=1e-5)
    assert found.free == 2
