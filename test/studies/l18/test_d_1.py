"""The end of the travel from a flow characteristic and from a recording that reaches it."""
import numpy as np
import pytest

from hydro_twin.fitting.parts import parts_of
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import effect_unknowns, plant_unknowns
from hydro_twin.model import Model, place
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.recording.series import Recording
from hydro_twin.simulation.sensor import measure
from hydro_twin.studies.l18.demonstration import LIMIT_STEPS, NOISE, simulated_steps
from hydro_twin.studies.l18.flow_characteristic import default_characteristic
from hydro_twin.studies.l18.linear_loop import PUBLISHED


def test_curve_and_recording_agree() -> None:
    curve = default_characteristic()
    series, _ = measure(simulated_steps(LIMIT_STEPS, curve), 'opening', None, NOISE, 0.0,
                        np.random.default_rng(4))
    guess = place('saturation', 'stem', {'lower': -10.0, 'upper': 1.02}, VALVE_SERVO)
    values = {**PUBLISHED._asdict(), 'T_y': 0.015}
    start = Model(VALVE_SERVO, values, series.sample_time, (guess,), substeps=2)
    unknowns = [*plant_unknowns(VALVE_SERVO, 'physical'), *effect_unknowns(0, guess)[1:]]
    fit = Problem(start, unknowns, parts_of(Recording((series,)), VALVE_SERVO)).solve()
    assert fit.candidate.effects[0].named['upper'] == pytest.approx(curve.d_1, abs=NOISE)
