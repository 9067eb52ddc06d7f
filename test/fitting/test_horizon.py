"""The error over a horizon, and the windows that a plant which integrates is fitted over."""
import numpy as np
import pytest

from hydro_twin.fitting.horizon import (
    errors_over_horizon,
    horizon_errors,
    judged_errors,
    moving_windows,
)
from hydro_twin.fitting.parts import parts_of
from hydro_twin.model import Model
from hydro_twin.plants import plant_named, PLANTS
from hydro_twin.recording.series import Recording, Series

CYLINDER = plant_named('cylinder')
DT = 0.02


def stroke(seconds, speed, offset=0.0, stop=np.inf, noise=0.0):
    """Integrate a sine command by hand, as a cylinder without lag; perhaps up to a stop."""
    t = DT * np.arange(round(seconds / DT))
    u = np.sin(2 * np.pi * t / 4.0) + offset
    x = np.empty(len(t))
    x[0] = 0.0
    for k in range(1, len(t)):
        x[k] = min(x[k - 1] + DT * speed * u[k - 1], stop)
    x += noise * np.random.default_rng(1).standard_normal(len(t))
    return Series({'command': u, 'x': x}, DT)


def cylinder(speed):
    return Model(CYLINDER, {'tau': 1e-4, 'K_v': speed}, DT)


def test_which_plants_integrate():
    assert {name for name, plant in PLANTS.items() if plant.integrates} == {
        'cylinder', 'positioning', 'rotary_axis'}


def test_a_gain_that_is_wrong_counts_over_a_window_and_not_over_the_whole():
    """Of a constant command, x is missed by (K - K') u t, in a window from its begin on."""
    series = stroke(100.0, 0.1, offset=0.5)
    recording = Recording((series,))
    model = cylinder(0.11)
    error = horizon_errors(model, {'test': recording})['horizon']['test']
    missed = 0.01 * DT * np.cumsum(series['command'])
    windows = np.split(missed, 10)
    over_windows = np.sqrt(np.mean([np.mean((w - w[0]) ** 2) for w in windows]))
    assert error == pytest.approx(over_windows, rel=0.1)
    free_run = series['x'] - model.run(series)
    assert np.sqrt(np.mean(free_run ** 2)) > 5 * error


def test_each_window_has_its_own_start():
    """A jump of the position between two windows is no error of the laws."""
    series = stroke(20.0, 0.1)
    jumped = {**series.columns, 'x': series['x'] + 3.0 * (np.arange(1000) >= 500)}
    errors = errors_over_horizon(cylinder(0.1), Recording((Series(jumped, DT),)))
    assert len(errors) == 2
    assert np.abs(np.concatenate(errors)).max() < 5e-3


def test_none_of_a_series_that_is_too_short():
    assert horizon_errors(cylinder(0.1), {'test': Recording((stroke(0.2, 0.1),))}) == {}


@pytest.mark.parametrize(('tau', 'needed'), [(0.5, False), (20.0, True)])
def test_a_valve_that_forgets_its_start_slowly_needs_a_horizon(tau, needed):
    """The first sample, from which a free run starts, is off; the valve stays where it is."""
    plant = plant_named('control_valve')
    model = Model(plant, {'tau': tau, 'K': 1.0}, 0.1)
    opening = 0.5 + 0.01 * np.random.default_rng(0).standard_normal(400)
    opening[0] = 0.6
    recording = Recording((Series({'command': np.full(400, 0.5), 'opening': opening}, 0.1),))
    assert judged_errors(model, recording)[1] == needed


def test_a_plant_that_integrates_needs_a_horizon():
    assert judged_errors(cylinder(0.1), Recording((stroke(20.0, 0.1),)))[1]


def test_standing_at_a_stop_is_left_out_of_a_plain_fit():
    moving = parts_of(Recording((stroke(40.0, 0.1),)), CYLINDER)
    windows, left_out = moving_windows(moving, CYLINDER, DT)
    assert left_out == 0.0
    assert sum(len(window.measured) for window in windows) == 2000
    standing = parts_of(Recording((stroke(40.0, 0.1, offset=0.9, stop=0.5),)), CYLINDER)
    windows, left_out = moving_windows(standing, CYLINDER, DT)
    assert left_out > 0.5
    assert all(window.measured.max() < 0.48 for window in windows)
