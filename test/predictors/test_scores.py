"""The errors that are reported: one definition, which the live twin and the trace keep to."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.fitting.parts import parts_of
from hydro_twin.fitting.physics import fit_physics, Task
from hydro_twin.live.twin import Twin
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.plants.cylinder import CYLINDER
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import errors_of
from hydro_twin.recording.series import Recording, Series, split

MODES = ('one_step', 'free_run')


def model(effects=(), **values):
    middle = {p.name: float(np.sqrt(p.lower * p.upper)) for p in VALVE_SERVO.parameters}
    return Model(VALVE_SERVO, {**middle, **values}, 0.002, effects)


def recording(samples=(300, 40, 200)):
    """Run the servo under random commands, with noise; only the last series begins in motion."""
    rng = np.random.default_rng(3)
    series = []
    for n in samples:
        command = 0.5 + 0.4 * np.cumsum(rng.standard_normal(n + 70)) / np.sqrt(n)
        blank = Series({'command': command, 'opening': np.full(n + 70, command[0])}, 0.002)
        opening = Analytical(model()).free_run(blank) + 1e-3 * rng.standard_normal(n + 70)
        series.append(Series({'command': command, 'opening': opening}, 0.002).part(
            70 * (n == samples[-1]), n + 70 * (n == samples[-1])))
    return Recording(tuple(series))


@pytest.mark.parametrize('effects', [
    (), (place('dead_zone', 'converter', {'width': 0.01}, VALVE_SERVO),)])
def test_the_twin_watches_what_the_model_promises(effects):
    """Series by series, 50 samples of a free run and 4 of a one-step run are not counted."""
    whole = recording()
    lacking = model(effects, T_y=0.03)
    scored = errors_of(Analytical(lacking), {'test': whole})
    for mode, unscored in (('one_step', 4), ('free_run', 50)):
        twin = Twin('', Analytical(lacking.with_record(errors={'after': scored})), mode)
        seen = []
        twin.monitor.add = lambda _, residual, seen=seen: seen.append(residual)
        for series in whole.series:
            twin.reset()
            for k, (u, y) in enumerate(zip(series['command'], series['opening'], strict=True)):
                twin.step(2_000_000 * k, np.array([u]), float(y))
        assert len(seen) == sum(max(len(s) - unscored, 0) for s in whole.series)
        assert np.sqrt(np.mean(np.square(seen))) == pytest.approx(twin.reference_rms, rel=1e-9)


def test_a_part_in_the_midst_of_a_motion_is_scored_in_the_run_of_its_series():
    whole = recording()
    predictor = Analytical(model(T_y=0.03))
    train, test = split(whole)
    found = errors_of(predictor, {'train': train, 'test': test})['free_run']
    expected = {'train': [], 'test': []}
    for series in whole.series:
        error, n = series['opening'] - predictor.free_run(series), len(series)
        expected['test'].append(error[50:n // 3])
        expected['train'].append(error[max(50, n // 3):])
    for name, errors in expected.items():
        assert found[name] == pytest.approx(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def test_the_start_up_is_a_time():
    for plant in PLANTS.values():
        assert plant.start_samples(plant.sample_time) == (
            4 if plant.name == 'control_valve' else 50)
    assert CYLINDER.start_samples(0.05) == 6            # few, but enough for its two states
    assert CYLINDER.start_samples(0.001) == 100
    time = 0.05 * np.arange(40)
    series = Series({'command': np.sin(time), 'x': np.cos(time)}, 0.05)
    part, = parts_of(Recording((series,)), CYLINDER)
    assert len(part.measured) == 40


def test_a_one_step_fit_has_standard_errors_where_its_residual_is_white():
    """The noise drives the difference equation itself, so that least squares has no bias."""
    rng = np.random.default_rng(0)
    true = model(T_y=0.02, tau=0.005, T_c=0.2, k_1=1.0)
    equation = Analytical(true).equation
    command = np.repeat(rng.uniform(0.0, 1.0, 200), 20)
    y = np.zeros(len(command))
    for k in range(3, len(y)):
        y[k] = (-equation.a @ y[k - 3:k][::-1] + equation.b[:, 0] @ command[k - 3:k + 1][::-1]
                + 1e-4 * rng.standard_normal())
    recording = Recording((Series({'command': command, 'opening': y}, 0.002),))
    found = fit_physics(Task(recording, VALVE_SERVO, {}, 'one_step', 0, {}), 'least_squares')
    assert not any('biases' in note for note in found.notes)
    for name in ('T_y', 'tau'):
        error = found.uncertainty[name].std_error
        assert abs(found.values[name] - true.values[name]) < 4 * error
