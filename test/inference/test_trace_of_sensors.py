"""Traces of a rig with sensors beside the torque, of which one fails half-way."""
from dataclasses import replace

import numpy as np
import pytest
from traced_rig import PLANT, record

from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import parts_of
from hydro_twin.fitting.port_signals import predicted_by_ports
from hydro_twin.inference.criterion import delta_bic, gain_p_value
from hydro_twin.inference.screen import screen
from hydro_twin.inference.search import LONG, search
from hydro_twin.inference.structure import drift_test, free_curves
from hydro_twin.inference.trace import trace
from hydro_twin.model import place
from hydro_twin.recording.series import Recording
from hydro_twin.report.summary import summarise
from hydro_twin.schema import fault

NOISE = 1.0
SENSORS = {'p_L': 5e4, 'x_v': 3e-7, 'omega_m': 5e-3}


@pytest.fixture(scope='module')
def rubbing():
    return record(('friction', 'motor', {'coulomb': 6.0}), count=1, duration=2.4, noise=NOISE,
                  sensors=SENSORS)


def torque_only(recording):
    return Recording(tuple(replace(one, columns={
        name: column for name, column in one.columns.items() if name not in SENSORS})
        for one in recording.series))


def test_the_linear_tools_see_the_output_alone_and_the_criterion_all(rubbing):
    parts = parts_of(rubbing, PLANT)
    plant = PLANT.seen_by(SENSORS)
    fit = fit_linear(plant, parts, PLANT.constant_values(), 0.002, starts=1)
    fit = search(fit.candidate, parts, LONG)
    scored = sum(len(part.measured) for part in parts) - fit.candidate.start_up
    assert sum(map(len, fit.by_part)) == scored
    assert [len(pieces) for pieces in fit.by_output] == [1, 1, 1, 1]
    assert screen(fit, parts)
    assert free_curves(fit, parts)
    assert drift_test(fit, parts)[0] < 1.0
    assert predicted_by_ports(fit, parts)[0] < 1.0

    rubs = replace(fit.candidate, effects=(place('friction', 'motor', {'coulomb': 6.0}, PLANT),))
    with_it = search(rubs, parts, 20)
    before, after = delta_bic([fit, with_it])
    assert gain_p_value(fit, with_it, 1) < 1e-9
    alone = [replace(part, sensors={}) for part in parts]
    one = [search(candidate, alone, 20) for candidate in (fit.candidate, rubs)]
    assert before - after > np.subtract(*delta_bic(one))


@pytest.mark.slow
def test_three_sensors_name_an_effect_at_least_as_well_as_one(rubbing):
    found = {name: trace(recording, None, PLANT) for name, recording in (
        ('one', torque_only(rubbing)), ('all', rubbing))}
    alone, report = (summarise(found[name]) for name in ('one', 'all'))
    for one in (alone, report):
        assert [effect['id'] for effect in one['effects']] == ['friction']
    assert report['effects'][0]['certain']
    assert not fault(report, 'report')
    friction = report['effects'][0]['parameters']['coulomb']
    assert abs(friction['value'] - 6.0) < 4.0 * friction['std_error']
    assert friction['std_error'] < 0.7 * alone['effects'][0]['parameters']['coulomb']['std_error']
    rivals = [one['effects'][0]['rivals'][0]['delta_bic'] for one in (alone, report)]
    assert rivals[1] > rivals[0]
    assert report['outputs'].keys() == {'T_g', *SENSORS}
    for name, noise in {'T_g': NOISE, **SENSORS}.items():
        assert report['outputs'][name]['noise'] == pytest.approx(noise, rel=0.1)
        assert report['outputs'][name]['after']['test'] == pytest.approx(noise, rel=0.2)
    assert report['outputs']['T_g']['after'] == report['after']['free_run']
    assert list(alone['outputs']) == ['T_g']
