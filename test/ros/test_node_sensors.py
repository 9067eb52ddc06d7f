"""The node as a real process, with sensors beside the output of which one fails."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from ros_rig import INPUTS, lossless, OUTPUTS, play, Rig, stamp_of, twin  # noqa: E402,I100
from sensor_msgs.msg import JointState  # noqa: E402

from hydro_twin import api  # noqa: E402
from hydro_twin.model import load_predictor, Model, Noise, write_model  # noqa: E402
from hydro_twin.plants import plant_named  # noqa: E402
from hydro_twin.predictors.analytical import Analytical  # noqa: E402
from hydro_twin.recording.rig import rig_of  # noqa: E402
from hydro_twin.recording.series import Series  # noqa: E402
from hydro_twin.recording.write import write_recording  # noqa: E402

pytestmark = [pytest.mark.slow,   # what rclpy imports imports what is out of date
              pytest.mark.filterwarnings("ignore:module 'sre_")]

PLANT = plant_named('load_simulator')
RIG = rig_of(PLANT)
START = 1_700_000_000_123_456_789
SAMPLES = 2000
EVERY = {'p_L': 1, 'x_v': 5, 'omega_m': 2}      # samples of the torque to one of the sensor
NOISE = Noise(1.0, {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1},
              {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01},
              sensors={'p_L': 3e4, 'x_v': 1e-6, 'omega_m': 5e-3})


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('models') / 'model.yaml'
    write_model(Model(PLANT, PLANT.constant_values() | PLANT.middle(), PLANT.sample_time,
                      noise=NOISE), path)
    return path


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory, model: Path) -> Path:
    """Record what the model does, with noise; the pressure fails half-way."""
    rng, time_ = np.random.default_rng(3), np.arange(SAMPLES) * 0.002
    columns = {'u_m': 0.3 * np.sin(2 * np.pi * 7 * time_), 'theta_d': 0.01 * np.sin(9 * time_),
               'T_g': np.zeros(SAMPLES)}
    predictor = load_predictor(model)
    assert isinstance(predictor, Analytical)
    series = Series(columns, 0.002, START)
    true = {**predictor.sensors(series), 'T_g': predictor.free_run(series)}
    spread = {'T_g': NOISE.measurement, **NOISE.sensors}
    for name, rms in spread.items():
        columns[name] = true[name] + rms * rng.normal(size=SAMPLES)
    for name, every in EVERY.items():
        columns[name][np.arange(SAMPLES) % every > 0] = np.nan
    columns['p_L'][SAMPLES // 2:] = np.nan
    path = tmp_path_factory.mktemp('bags') / 'bag'
    write_recording(path, [replace(series, columns=columns)],
                    RIG.signals | {name: RIG.sensors[name] for name in EVERY})
    return path


def test_with_sensors_live_is_replay_to_the_last_digit_and_one_may_fail(
        rig: Rig, bag: Path, model: Path) -> None:
    predictions = rig.listen('/hydro_twin/prediction', JointState)
    states = rig.listen('/hydro_twin/states', JointState)
    (series,) = api.read(bag, PLANT).recording.series
    predictor = load_predictor(model)
    assert isinstance(predictor, Analytical)
    expected, estimates = predictor.observed(series)
    stamps = series.stamps.tolist()
    topics = [RIG.sensors[name].topic for name in EVERY]
    named = {f'signals.{name}.topic': RIG.sensors[name].topic for name in RIG.sensors}
    with twin(model=model, **named, **lossless(
            [*INPUTS, *topics], [*OUTPUTS, '/hydro_twin/states'])
            | {'wait': 1.0}):           # how long the pressure is waited for when it fails
        rig.ready([*INPUTS, *topics])
        play(bag)
        rig.until(lambda: len(predictions) >= SAMPLES and len(states) >= SAMPLES,
                  'all is predicted')
        rig.status('input /load_simulator/pressure', 'no message for')
    assert [stamp_of(m) for m in predictions] == stamps
    np.testing.assert_array_equal([m.effort[0] for m in predictions], expected)
    np.testing.assert_array_equal([m.position for m in states], estimates.reshape(SAMPLES, -1))
    deviation = estimates[:, 1, PLANT.states.index('p_L')]
    assert np.median(deviation[-500:]) > 1.2 * np.median(deviation[500:1000])
