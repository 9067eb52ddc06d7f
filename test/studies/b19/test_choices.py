"""What the study varies: the alignment, the output unit, and the model without physics."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_twin.model import Model
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.recording.series import Recording, Series
from hydro_twin.studies.b19.choices import delayed
from hydro_twin.studies.b19.outlook import Arx


def test_delayed_pairs_an_output_with_the_inputs_before() -> None:
    columns = {name: 10.0 * k + np.arange(6.0) for k, name in
               enumerate(('u_m', 'theta_d', 'T_g'))}
    (late,) = delayed(Recording((Series(columns, 0.002),)), ['u_m', 'theta_d']).series
    assert late['T_g'].tolist() == columns['T_g'].tolist()
    assert late['u_m'][1:].tolist() == columns['u_m'][:-1].tolist()
    assert late['theta_d'][1:].tolist() == columns['theta_d'][:-1].tolist()


def test_the_model_without_physics_is_a_difference_equation() -> None:
    """Against scipy's filter, from rest."""
    rng = np.random.default_rng(0)
    a, b, e = rng.uniform(-0.3, 0.3, 4), rng.normal(size=5), rng.normal(size=5)
    u, theta = rng.normal(size=(2, 80))
    u[:5] = theta[:5] = 0.0
    y = (lfilter(b, np.r_[1.0, -a], u) + lfilter(e, np.r_[1.0, -a], theta))
    series = Series({'u_m': u, 'theta_d': theta, 'T_g': y}, 0.002)
    arx = Arx(Model(LOAD_SIMULATOR, {'D_m': 2e-5}, 0.002, kind='mlp'), np.r_[a, b, e])
    np.testing.assert_allclose(arx.free_run(series), y, atol=1e-12)
    np.testing.assert_allclose(arx.one_step(series)[5:], y[5:], atol=1e-12)
    assert np.isnan(arx.one_step(series)[:5]).all()


def test_the_gradient_through_a_bounded_output_is_that_of_differences() -> None:
    torch = pytest.importorskip('torch')
    from hydro_twin.fitting.rprop import gradient
    rng = np.random.default_rng(1)
    sizes, weights = [3, 4, 1], torch.tensor(rng.normal(size=(2, 21)))
    x, y = torch.tensor(rng.normal(size=(2, 9, 3))), torch.tensor(rng.normal(size=(2, 9, 1)))
    out, unused = torch.empty_like(weights), torch.empty_like(weights)
    gradient(weights, sizes, x, y, 0.0, out, bounded=True)
    for i in range(21):
        step = torch.zeros_like(weights)
        step[:, i] = 1e-6
        above, below = (gradient(weights + sign * step, sizes, x, y, 0.0, unused, bounded=True)
                        for sign in (1, -1))
        np.testing.assert_allclose(out[:, i], (above - below) / 4e-6, rtol=1e-5, atol=1e-7)
