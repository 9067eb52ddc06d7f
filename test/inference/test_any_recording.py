"""Whatever was recorded, a trace ends in a verdict or in one line."""
from __future__ import annotations

from contextlib import redirect_stdout
from dataclasses import replace
from functools import cache
from io import StringIO
import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import example, given, HealthCheck, Phase, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from hydro_twin.commands.main import main
from hydro_twin.errors import UserError
from hydro_twin.fitting.parts import parts_of, thin
from hydro_twin.fitting.port_signals import predicted_by_ports
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.inference.curve import find_curve
from hydro_twin.inference.excerpt import decimation_factor, excerpt
from hydro_twin.inference.held_out import held_out_gain
from hydro_twin.inference.noise import bursts, lines, noise_floor
from hydro_twin.inference.screen import screen, undetectable
from hydro_twin.inference.search import search
from hydro_twin.inference.structure import dependences, drift_test, free_curves
from hydro_twin.inference.trace import trace
from hydro_twin.model import Model
from hydro_twin.plants import PLANTS
from hydro_twin.recording.rig import read, rig_of
from hydro_twin.recording.series import Recording
from hydro_twin.report.summary import summarise
from hydro_twin.schema import fault

BAGS = Path(__file__).parents[2] / 'bags'
SOURCES = (('load_simulator', 'rig_a'), ('valve_servo', 'valve_limit'))
MAPS = BAGS.parent / 'config' / 'measured'
MEASURED = tuple((plant, (table, f'{table_map}.yaml')) for plant, table, table_map in (
    ('positioning', 'positioning/DATA_EMPS.mat', 'positioning'),
    ('cylinder', 'eha/load1_stroke25mm.csv.gz', 'eha'),
    ('control_valve', 'water_valve/actuator3_2001-10-11_1h.csv.gz', 'water_valve'),
    ('load_simulator', 'leg/policy1_sin1Hz.csv.gz', 'leg'),
    ('cylinder', 'excavator/manual_mitch_1101_2333.csv.gz', 'excavator_boom'),
    ('cylinder', 'servo_valve_cylinder/steps_3V.csv.gz', 'servo_valve_cylinder'),
))
DATA = Path(os.environ.get('HYDRO_TWIN_DATA', 'nowhere'))
MORE = int(os.environ.get('HYDRO_TWIN_EXAMPLES', '1'))      # times as many, to search for more


def examples(count):
    """Set how many to try; not to make a failing one smaller, which takes minutes."""
    return settings(max_examples=MORE * count, derandomize=MORE == 1,
                    phases=(Phase.explicit, Phase.generate),
                    suppress_health_check=list(HealthCheck), deadline=None)


# Numbers that overflow end as errors that are very large, which numpy remarks on.
pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')


def bent(column, how):
    """Spoil a column in one of the ways in which recordings are spoilt."""
    size = np.abs(column).max() + 1e-9
    match how:
        case 'constant':
            return np.full_like(column, column[0])
        case 'zero':
            return np.zeros_like(column)
        case 'huge':
            return 1e12 * column
        case 'tiny':
            return 1e-12 * column
        case 'spiky':
            spoilt = column.copy()
            spoilt[::37] = 1e6 * size
            return spoilt
        case 'coarse':
            return np.round(3.0 * column / size)
        case 'bursting':
            return np.where(np.arange(len(column)) < len(column) // 2, 0.0, column)
    return column


HOWS = st.sampled_from(['as it is'] * 4 + ['constant', 'zero', 'huge', 'tiny', 'spiky', 'coarse',
                                           'bursting'])


def cuts(largest, sources=SOURCES):
    """Draw how one to three series are cut out of a recording, and how they are spoilt."""
    place = st.floats(0.0, 1.0)
    return st.tuples(
        st.sampled_from(sources), st.lists(HOWS, min_size=3, max_size=3), st.booleans(),
        st.lists(st.tuples(place, place, st.integers(60, largest)), min_size=1, max_size=3))


def sample(name, bag):
    """Read a sample bag."""
    return read([BAGS / bag], rig_of(PLANTS[name]))


def recording_of(drawn, whole_of=sample):
    """Make the recording that was drawn; (plant, recording)."""
    (name, source), hows, alike, places = drawn
    plant = PLANTS[name]
    whole = whole_of(name, source).series
    spoilt = dict(zip((signal.name for signal in plant.signals), hows, strict=False))
    series = []
    for which, where, length in places:
        one = whole[round(which * (len(whole) - 1))]
        begin = round(where * max(len(one) - length, 0))
        cut = one.part(begin, begin + length)
        series.append(replace(cut, columns={
            column: bent(values, spoilt[column]) for column, values in cut.columns.items()}))
    return plant, Recording(tuple(series[:1] * len(series) if alike else series))


def fitted(plant, recording):
    """Fit the linear plant by one step from the middle of its box: a fit as bad as any."""
    parts = parts_of(recording, plant)
    values = plant.constant_values() | {p.name: (p.lower * p.upper) ** 0.5
                                        for p in plant.parameters}
    sample_time = recording.series[0].sample_time
    return search(Model(plant, values, sample_time, substeps=2), parts, 2), parts


def attempted(work, *arguments):
    """Do it; returns what comes of it and '', or None and the error that a user is shown."""
    try:
        return work(*arguments), ''
    except UserError as error:
        return None, str(error)


def is_one_line(said):
    return said.strip() != '' and '\n' not in said.strip()


def is_share(value):
    return 0.0 <= value <= 1.0 + 1e-9       # nan is none


def failed(checks):
    """Name the checks that do not hold."""
    return [name for name, holds in checks.items() if not holds]


def wrong_answers(fit, parts):
    """Ask all that a trace asks of a fit, but for full fits of effects; name the wrong answers."""
    plant, sample_time = fit.candidate.plant, fit.candidate.sample_time
    residuals = fit.by_part
    curves = dependences(fit, parts)
    tests = [drift_test(fit, parts), predicted_by_ports(fit, parts),
             *((curve.share, curve.p_value) for curve in curves)]
    factor = decimation_factor(fit, parts, 10**6)
    taken = thin(excerpt(parts, plant, sample_time, factor), plant, factor)
    measured = np.concatenate([whole.measured for whole in parts])
    same = held_out_gain(fit, fit, parts, 0)
    return failed({
        'noise floor': 0.0 <= noise_floor(residuals) < np.inf,
        'whiteness': is_white(residuals) in (True, False),
        'lines': all(0.0 < line.frequency <= 0.5 / sample_time and line.amplitude > 0.0
                     for line in lines(residuals, sample_time)),
        'bursts': all(0 <= burst.begin < burst.end <= len(residuals[burst.stretch])
                      for burst in bursts(residuals)),
        'curves': all(np.isfinite(curve.curve).all() and (np.diff(curve.knots) > 0.0).all()
                      for curve in curves),
        # By cross-validation: below zero where it only harms.
        'shares explained': all(share <= 1.0 + 1e-9 for share, _ in tests),
        'p-values': all(is_share(p_value) for _, p_value in tests),
        'standard errors': all(error is None or error >= 0.0
                               for error in fit.identifiability().std_error.values()),
        'factor of thinning': factor >= 1,
        'no sample is taken twice': factor * sum(len(part.measured) for part in taken) <= len(
            measured),
        'no sample is made up': all(np.isin(part.measured, measured).all() for part in taken),
        'no change': (same.relative, same.low, same.high) == (0.0, 0.0, 0.0),
    })


@examples(4)
@given(cuts(largest=160))
def test_what_is_asked_of_any_fit_is_answered(drawn):
    found, refusal = attempted(fitted, *recording_of(drawn))
    assert is_one_line(refusal) if found is None else wrong_answers(*found) == []


@pytest.mark.slow
@examples(8)
@given(cuts(largest=300))
def test_screening_and_curves_are_answered_too(drawn):
    made, refusal = attempted(fitted, *recording_of(drawn))
    if made is None:
        assert is_one_line(refusal)
        return
    assert wrong_answers(*made) == []
    fit, parts = made
    scored = screen(fit, parts)
    for one in scored:
        assert is_share(one.share)
        assert 0.0 <= one.gain < np.inf
        assert one.placed.port in fit.candidate.plant.ports
    assert all(h.id and h.port and h.says and '\n' not in h.says for h in undetectable(fit, parts))
    found = find_curve(fit, parts, parts, [replace(curve, p_value=0.0, share=1.0)
                                           for curve in free_curves(fit, parts)], 0)
    if found is not None:
        assert found.fit.error <= fit.error
        assert 0.0 < found.gain.low <= found.gain.relative <= found.gain.high <= 1.0
        assert np.isfinite(found.placed.values).all()
        assert all(distance >= 0.0 for _, distance in found.others)


def wrong_in(found):
    """Name what does not hold of a result, as it is written: strict JSON, of the schema."""
    report = json.loads(json.dumps(summarise(found), allow_nan=False))
    improvement = report['improvement']
    judged = 'free_run' if report['horizon_s'] is None else 'horizon'
    before, after = (report[when][judged]['test'] for when in ('before', 'after'))
    return failed({
        'schema': fault(report, 'report') == '',
        'verdict': report['verdict'] in ('effect_found', 'nothing_missing', 'unexplained'),
        'effects': bool(report['effects']) == (report['verdict'] == 'effect_found'),
        'one line': '\n' not in report['says'],
        'parameters': all(p['value'] is not None and np.isfinite(p['value'])
                          for when in ('before', 'after')
                          for p in report['parameters'][when].values()),
        # Only what improves on data that were not fitted is added.
        'improvement': (0.0 < improvement['low'] <= improvement['high'] if found.changed
                        else improvement['relative'] == 0.0),
        'errors': after <= before if found.changed else report['after'] == report['before'],
    })


# So large that every run which follows it counts as diverged.
@pytest.mark.slow
@examples(2)
@example((('load_simulator', 'rig_a'), ['spiky', 'zero', 'huge'], False,
          [(0.35, 0.12, 400), (0.06, 0.78, 280)]))
@given(cuts(largest=300))
def test_a_trace_ends_in_a_verdict_or_one_line(drawn):
    plant, recording = recording_of(drawn)
    found, refusal = attempted(trace, recording, None, plant)
    assert is_one_line(refusal) if found is None else wrong_in(found) == []


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / 'eha').is_dir(), reason='HYDRO_TWIN_DATA is not set')
@examples(3)
@given(cuts(largest=300, sources=MEASURED))
def test_a_trace_of_measured_data_ends_in_a_verdict_or_one_line(drawn):
    plant, recording = recording_of(drawn, measured)
    found, refusal = attempted(trace, recording, None, plant)
    assert is_one_line(refusal) if found is None else wrong_in(found) == []


@cache
def measured(name, source):
    """Read a table of measured data, by way of a bag."""
    table, table_map = source
    with TemporaryDirectory() as folder, redirect_stdout(StringIO()):
        bag = Path(folder) / 'bag'
        assert main(['import', str(DATA / table), '-o', str(bag), '--map', str(MAPS / table_map),
                     '--json']) == 0
        return read([bag], rig_of(PLANTS[name]))


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / 'faults').is_dir(), reason='HYDRO_TWIN_DATA is not set')
def test_a_servo_at_its_end_stop():
    rig = rig_of(PLANTS['valve_servo'])
    recording = read([DATA / 'faults' / 'valve_stop' / 'run0'], rig)
    found, refusal = attempted(trace, recording, None, rig.plant)
    assert is_one_line(refusal) if found is None else wrong_in(found) == []
