"""Tracing from end to end: what it names, what it does not, and what must not change that."""
from dataclasses import dataclass, field, replace
import importlib
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from traced_rig import PLANT, record, VALUES
import yaml

from hydro_twin.as_json import as_json
from hydro_twin.commands.main import main
from hydro_twin.errors import DataError
from hydro_twin.fitting.horizon import errors_over_horizon
from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import parts_of
from hydro_twin.inference import confirmation
from hydro_twin.inference.confirmation import beats_constant, reported_gain
from hydro_twin.inference.held_out import improvement
from hydro_twin.inference.trace import evidence, trace
from hydro_twin.inference.verdict import verdict_of
from hydro_twin.model import Model, place, read_model
from hydro_twin.plants import plant_named
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.read import read_recording
from hydro_twin.recording.series import Recording, Series, split
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording
from hydro_twin.report.summary import summarise
from hydro_twin.simulation.simulate import simulate

FRICTION = ('friction', 'motor', {'coulomb': 6.0})
SHORT = {'count': 2, 'duration': 2.4}
ERRORS = {mode: {'train', 'test'} for mode in ('one_step', 'free_run', 'observer')}


def report_of(recording, seed=0):
    return summarise(trace(*split(recording), PLANT, seed=seed))


def named(report):
    return [(effect['id'], effect['port']) for effect in report['effects']]


def verb(capsys, *arguments):
    """Run a verb with --json: its status, its object, its complaint."""
    status = main([*map(str, arguments), '--json'])
    out, err = capsys.readouterr()
    return status, json.loads(out) if out else None, err


@pytest.fixture(scope='module')
def rubbing():
    return record(FRICTION, **SHORT)


@pytest.fixture(scope='module')
def files(rubbing, tmp_path_factory):
    """Write the recording to a bag, and each series to one with own units and topics."""
    folder = tmp_path_factory.mktemp('trace')
    signals = load_signals(PLANT.name, [signal.name for signal in PLANT.signals])
    write_recording(folder / 'bag', rubbing.series, signals, {})
    other = {
        'u_m': {'topic': '/amplifier', 'type': 'sensor_msgs/msg/JointState',
                'field': 'effort[0]', 'scale': 0.1, 'offset': -1.0},        # % of 10 V, from -10
        'theta_d': {'topic': '/shaft', 'type': 'sensor_msgs/msg/JointState',
                    'field': 'position[0]', 'scale': math.pi / 180},        # degrees
        'T_g': {'topic': '/shaft', 'type': 'sensor_msgs/msg/JointState',
                'field': 'effort[0]', 'scale': 1e-3, 'offset': 0.0},        # N mm
    }
    config = {'/**': {'ros__parameters': {'signals': other}}}
    (folder / 'own.yaml').write_text(yaml.safe_dump(config))
    own = load_signals(PLANT.name, list(other), folder / 'own.yaml')
    for name, series in zip(('first', 'second'), rubbing.series, strict=True):
        write_recording(folder / name, [series], own, {})
    return folder


@pytest.fixture(scope='module')
def traced(files):
    """Trace that bag by the verb; returns its folder."""
    assert main(['trace', str(files / 'bag'), '--plant', PLANT.name, '-o',
                 str(files / 'traced')]) == 0
    return files / 'traced'


@pytest.fixture(scope='module')
def reference(traced):
    return json.loads((traced / 'report.json').read_text())


def assert_same_finding(report, reference, rel):
    assert report['verdict'] == reference['verdict'] == 'effect_found'
    assert named(report) == named(reference) == [FRICTION[:2]]
    one, other = (r['effects'][0] for r in (report, reference))
    assert one['certain'] == other['certain']
    assert one['parameters']['coulomb']['value'] == pytest.approx(
        other['parameters']['coulomb']['value'], rel=rel)
    for when in ('before', 'after'):
        assert report[when]['free_run']['test'] == pytest.approx(
            reference[when]['free_run']['test'], rel=0.02)


@pytest.mark.slow
def test_an_effect_is_named_with_its_value(reference):
    assert reference['verdict'] == 'effect_found'
    (effect,) = reference['effects']
    assert (effect['id'], effect['port']) == FRICTION[:2]
    assert effect['certain']
    coulomb = effect['parameters']['coulomb']
    assert coulomb['unit'] == 'N m'
    assert abs(coulomb['value'] - 6.0) < 4 * coulomb['std_error'] + 0.02 * 6.0
    assert coulomb['std_error'] < 0.3
    assert effect['p_value'] < 1e-6
    assert reference['ambiguous'] == []
    # What is left is the noise, on data that were not fitted too.
    assert reference['after']['free_run']['test'] == pytest.approx(0.5, rel=0.1)
    assert reference['noise_floor'] == pytest.approx(0.5, rel=0.1)
    assert reference['before']['free_run']['test'] > 3 * reference['after']['free_run']['test']
    assert reference['improvement']['low'] > 0.8


@pytest.mark.slow
def test_two_effects_are_both_named():
    """With one alone in the model, neither helps much: each is bent by the other."""
    report = report_of(record(FRICTION, ('hysteresis', 'command', {'width': 0.03}), seed=2,
                              **SHORT))
    assert {(e['id'], e['port']) for e in report['effects']} == {
        FRICTION[:2], ('hysteresis', 'command')}
    values = {e['id']: e['parameters'] for e in report['effects']}
    assert values['friction']['coulomb']['value'] == pytest.approx(6.0, rel=0.05)
    assert values['hysteresis']['width']['value'] == pytest.approx(0.03, rel=0.05)
    assert report['after']['free_run']['test'] == pytest.approx(0.5, rel=0.1)


@pytest.mark.slow
def test_a_long_recording_of_an_axis_that_integrates(monkeypatch):
    """Stretches, thinned, find the effects; the values come from all samples."""
    monkeypatch.setattr('hydro_twin.inference.excerpt.MAX_SAMPLES', 1_500)
    monkeypatch.setattr('hydro_twin.inference.excerpt.STRETCH_SAMPLES', 500)
    plant = plant_named('positioning')
    placed = [place('friction', 'motor', {'coulomb': 20.0}, plant),
              place('bias', 'motor', {'offset': 3.0}, plant)]

    def force(t):
        return -np.expm1(-(t / 0.1)**2) * sum(
            size * np.sin(2 * np.pi * f * t + f)
            for size, f in ((70, 0.93), (50, 2.5), (30, 6.3)))

    one = simulate(plant, {'M': 95.0, 'F_v': 200.0}, placed, {'force': force}, 6.0)
    x = one['x'] + 1e-5 * np.random.default_rng(0).standard_normal(len(one))
    recording = Recording((replace(one, columns={**one.columns, 'x': x}),))
    found = evidence(*split(recording), plant)
    named = {placed.effect.id: placed.named for placed in found.after.candidate.effects}
    assert set(named) == {'friction', 'bias'}
    assert named['friction']['coulomb'] == pytest.approx(20.0, rel=0.01)
    assert named['bias']['offset'] == pytest.approx(3.0, rel=0.01)
    assert found.held_out_ratio * found.after.error < 1.1e-5
    assert [len(part.measured) for part in found.fitted] == [4000]


@pytest.mark.slow
def test_what_happens_in_the_first_third_only_is_found():
    """Then the second sixth tests, and the first is fitted."""
    rng = np.random.default_rng(0)
    f, phase = rng.uniform(0.5, 15.0, 8), rng.uniform(0, 2 * np.pi, 8)

    def command(t):
        size = np.where(t < 1.5, 0.3, 0.04) * -np.expm1(-(t / 0.1)**2)
        return size * np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1)

    one = simulate(PLANT, VALUES, [place('saturation', 'command', {
        'lower': -0.4, 'upper': 0.4}, PLANT)], {'u_m': command, 'theta_d': np.zeros_like}, 4.5)
    torque = one['T_g'] + 0.2 * rng.standard_normal(len(one))
    recording = Recording((replace(one, columns={**one.columns, 'T_g': torque}),))
    found = evidence(recording, None, PLANT)
    assert found.tested == 'sixth'
    assert [p.effect.id for p in found.after.candidate.effects] == ['saturation']
    assert found.held_out_ratio * found.after.error < 0.22


@pytest.mark.slow
def test_a_cylinder_between_its_stops_has_all_three_names():
    """Steps held until a stop, then back, by Euler's method: as a rig is tried out by hand."""
    T, fine = 0.02, 20
    rng = np.random.default_rng(1)
    series = []
    for volts in (1.0, 2.0, 3.0, 4.0, 5.0):
        time = np.arange(0.0, 24.0 / volts + 2.0, T)
        command = np.where(time < 0.1, 0.0, np.where(time < 0.5 * time[-1], volts, -volts))
        q = x = 0.0
        position = np.empty(len(time))
        for k in range(len(time)):
            position[k] = x
            live = np.sign(command[k]) * max(abs(command[k]) - 0.2, 0.0)
            for _ in range(fine):
                q += T / fine * (live - q) / 0.04
                x = min(max(x + T / fine * 0.03 * (q + 0.18 * abs(q)), 0.0), 0.2)
        series.append(Series({'command': command,
                              'x': position + 3e-4 * rng.standard_normal(len(time))}, T,
                             start=10**11 * len(series)))
    found = trace(Recording(tuple(series)), None, plant_named('cylinder'))
    assert found.tested == 'series'
    values = {(e.placed.effect.id, e.placed.port.name): e.placed.named for e in found.effects}
    assert set(values) == {('end_stop', 'piston'), ('asymmetry', 'piston'),
                           ('dead_zone', 'command')}
    assert values['asymmetry', 'piston']['imbalance'] == pytest.approx(0.18, abs=0.01)
    zone = values['dead_zone', 'command']       # which no step is within: what leaks is not seen
    assert zone['width'] * (1.0 - zone['leak']) == pytest.approx(0.2, abs=0.01)
    assert values['end_stop', 'piston']['upper'] == pytest.approx(0.2, abs=1e-3)
    assert found.after.errors['after']['free_run']['test'] < 5e-4


@pytest.mark.slow
def test_held_out_data_tell_apart_what_the_training_data_cannot():
    """The servo never leaves its stop in the training part, where a limit would do as well."""
    plant = plant_named('valve_servo')
    values = plant.constant_values() | {'T_y': 0.015, 'T_c': 0.2, 'tau': 0.005, 'k_1': 1.0}
    stop = place('end_stop', 'actuator', {'lower': 0.0, 'upper': 0.65}, plant)
    rng = np.random.default_rng(0)

    def recorded(ends, times, start):
        """Record ramps that begin at rest."""
        one = simulate(plant, values, [stop], {'command': lambda t: np.interp(t, times, ends)},
                       6.0, start=start)
        return replace(one, columns={
            **one.columns, 'opening': one['opening'] + 1e-3 * rng.standard_normal(len(one))})

    up = recorded([0.4, 0.4, 0.55, 0.3, 0.85, 0.85], [0.0, 0.3, 1.0, 2.0, 4.5, 6.0], 0)
    back = recorded([0.4, 0.4, 0.9, 0.3, 0.5, 0.5], [0.0, 0.3, 2.5, 4.0, 5.0, 6.0], 10**11)
    report = summarise(trace(Recording((up,)), Recording((back,)), plant))
    assert named(report) == [('end_stop', 'actuator')]
    assert 'saturation' not in {r['id'] for r in report['effects'][0]['rivals']
                                if r['delta_bic'] < 10.0}


def test_the_linear_fit_is_no_worse_than_that_of_refit():
    train, test = split(record(count=1, duration=1.2))
    refit = fit_linear(PLANT, parts_of(train, PLANT), PLANT.constant_values(), 0.002)
    assert evidence(train, test, PLANT).before.error < 1.001 * refit.error


@pytest.mark.slow
def test_one_process_finds_what_the_verb_does_on_all_cores(rubbing, files, reference,
                                                           monkeypatch):
    """To the last digit, and what it prints is what it writes."""
    monkeypatch.setattr('hydro_twin.parallel._cores', lambda: 1)
    read = Recording(tuple(replace(one, source=str(files / 'bag')) for one in rubbing.series))
    report = summarise(trace(read, None, PLANT))
    assert json.loads(json.dumps(as_json(report))) == reference


@pytest.mark.slow
def test_another_clock_does_not_matter(tmp_path, reference):
    """Recorded every millisecond, from another instant, with the measurement 0.4 ms off."""
    fast = record(FRICTION, plant=replace(PLANT, sample_time=0.001), **SHORT)
    signals = load_signals(PLANT.name, [signal.name for signal in PLANT.signals])
    write_recording(tmp_path / 'bag', [replace(s, start=s.start + 123_456_789)
                                       for s in fast.series], signals, {})
    read = read_recording([tmp_path / 'bag'], signals, {'u_m'}, PLANT.sample_time)
    assert [len(series) for series in read.series] == [1200, 1200]
    report = report_of(read)
    assert named(report) == [FRICTION[:2]]
    value = report['effects'][0]['parameters']['coulomb']['value']
    assert value == pytest.approx(reference['effects'][0]['parameters']['coulomb']['value'],
                                  rel=0.03)


@pytest.mark.slow
def test_what_may_make_the_free_run_worse_where_nothing_was_fitted_is_not_named(
        rubbing, monkeypatch):
    """The interval of what is reported must exclude zero."""
    honest = confirmation.reported_gain

    def worse(before, after, test, seed):
        gain, by_horizon = honest(before, after, test, seed)
        return (gain if after is before else replace(gain, low=-0.2, high=0.65)), by_horizon

    monkeypatch.setattr(confirmation, 'reported_gain', worse)
    found = evidence(rubbing, None, PLANT)
    assert found.findings == ()
    assert found.curve is None
    assert found.after is found.before
    assert verdict_of(found) == 'unexplained'


def test_a_stop_that_only_one_held_out_series_meets_does_not_refute_the_other():
    """Of a cylinder, whose lower stop was not among the data that were fitted."""
    plant = plant_named('cylinder')
    values = {'tau': 0.05, 'K_v': 0.1}
    both, upper = ((place('end_stop', 'piston', {'lower': lower, 'upper': 0.2}, plant),)
                   for lower in (-0.1, -1e9))
    series = [simulate(plant, values, both, {'command': command}, 6.0) for command in (
        lambda t: 1.2 * np.sin(t), lambda t: 1.5 * np.sin(t), lambda t: -3.0 * np.sin(t))]
    rng = np.random.default_rng(0)
    for one in series:
        one.columns['x'][:] += 1e-3 * rng.standard_normal(len(one))
    # Fitted without a stop, the cylinder is too slow.
    before, after = (SimpleNamespace(candidate=Model(
        plant, values | {'K_v': K_v}, plant.sample_time, effects))
        for K_v, effects in ((0.0985, ()), (0.1, upper)))
    test = Recording(tuple(series))
    then, now = (errors_over_horizon(one.candidate, test) for one in (before, after))
    falls = [rms(a) / rms(b) for a, b in zip(now, then, strict=True)]
    assert max(falls[:2]) < 0.1 < 1.0 < falls[2]
    assert improvement(then, now, 0).low < 0.0 < improvement(then, now, 0).relative
    gain, by_horizon = reported_gain(before, after, test, 0)
    assert by_horizon
    assert gain.low > 0.0


def test_an_offset_to_a_model_that_follows_nothing_does_not_beat_a_constant():
    """What is measured is noise about an offset, whatever the command; a short series counts not.

    The model with that offset is far better than that without, and no better than the offset.
    """
    rig = record()
    rng = np.random.default_rng(3)
    deaf = Recording(tuple(replace(one, columns={
        **one.columns, 'T_g': 40.0 + rng.standard_normal(len(one))}) for one in rig.series))
    gone = VALUES | {'K_q': 1e-6 * VALUES['K_q']}
    offset = Model(PLANT, gone, 0.002, (place('bias', 'sensor', {'offset': 40.0}, PLANT),))
    still = Recording(tuple(replace(one, columns={
        **one.columns, 'theta_d': np.zeros(len(one))}) for one in deaf.series))
    assert rms(np.concatenate(errors_over_horizon(offset, still))) < 2.0
    short = Recording((*still.series, still.series[0].part(0, 10)))
    assert not beats_constant(SimpleNamespace(candidate=offset), short, 0)
    assert beats_constant(SimpleNamespace(candidate=Model(PLANT, VALUES, 0.002)), rig, 0)


@pytest.mark.slow
def test_a_start_in_motion_that_lasts_hides_no_effect():
    """A leak so small that what a run starts with takes a third of a second to go."""
    slow = VALUES | {'K_ce': 0.1 * VALUES['K_ce']}
    moving = record(FRICTION, count=2, duration=3.5, values=slow)
    late = Recording(tuple(
        replace(series, columns={name: column[250:] for name, column in series.columns.items()})
        for series in moving.series))
    report = summarise(trace(late, None, PLANT))
    assert report['after']['free_run']['test'] > 5.0
    assert named(report) == [('friction', 'motor')]
    assert report['horizon_s'] == pytest.approx(1.0, abs=0.01)
    assert report['after']['horizon']['test'] == pytest.approx(0.5, rel=0.05)


@pytest.mark.slow
def test_labels_of_another_recording_name_nothing(rubbing):
    """The torque of one recording over the inputs of another."""
    other = record(seed=9, **SHORT)
    report = report_of(Recording(tuple(
        replace(a, columns={**b.columns, 'T_g': a['T_g']})
        for a, b in zip(rubbing.series, other.series, strict=True))))
    assert report['effects'] == []
    assert report['verdict'] != 'effect_found'


@pytest.mark.slow
def test_where_nothing_is_missing_nothing_is_named():
    report = report_of(record(seed=3, **SHORT))
    assert report['verdict'] == 'nothing_missing'
    assert report['effects'] == []
    assert report['ambiguous'] == []
    assert report['remainder']['lines_hz'] == []
    assert report['after'] == report['before']
    assert ('saturation', 'spool') in {(h['id'], h['port']) for h in report['cannot_show']}


@pytest.mark.slow
def test_a_line_is_left_to_be_told(tmp_path):
    """Mains hum on the sensor is no effect of the library: it is told by its frequency."""
    quiet = record(seed=5, **SHORT)
    hum = Recording(tuple(replace(s, columns={**s.columns, 'T_g': s['T_g'] + 1.5 * np.sin(
        2 * np.pi * 50.2 * 0.002 * np.arange(len(s)) + k)}) for k, s in enumerate(quiet.series)))
    report = report_of(hum)
    assert report['verdict'] == 'unexplained'
    assert report['effects'] == []
    assert report['remainder']['lines_hz'] == [pytest.approx(50.2, abs=0.3)]
    assert '50.' in report['remainder']['says']


@pytest.mark.slow
def test_what_happened_once_is_told_by_when():
    """A disturbance of a tenth of a second, two seconds after the bag began."""
    quiet = record(seed=5, **SHORT)
    first, second = quiet.series
    torque = first['T_g'] + 6.0 * np.exp(-((np.arange(len(first)) * 0.002 - 2.0) / 0.03)**2)
    shaken = replace(first, columns={**first.columns, 'T_g': torque})
    report = report_of(Recording((shaken, second)))
    assert (report['verdict'], report['effects']) == ('unexplained', [])
    (burst,) = report['remainder']['when']
    assert burst['bag'] == first.source
    assert burst['from_s'] < 2.0 < burst['to_s'] < burst['from_s'] + 0.35
    assert 'much of it is concentrated' in report['says']


@pytest.mark.slow
def test_own_units_topics_the_order_of_the_bags_and_the_seed_do_not_matter(
        files, tmp_path, capsys, reference):
    status, report, _ = verb(capsys, 'trace', files / 'second', files / 'first', '--plant',
                             PLANT.name, '--config', files / 'own.yaml', '--seed', 7, '-o',
                             tmp_path / 'out')
    assert status == 0
    assert [series['bag'] for series in report['series']] == [
        str(files / name) for name in ('second', 'first')]
    assert_same_finding(report, reference, rel=0.01)


@pytest.mark.slow
def test_the_verb_keeps_its_contract(files, traced, reference, tmp_path, capsys):
    out, report = traced, reference
    assert '<html' in (out / 'report.html').read_text()

    assert set(report) >= {'plant', 'verdict', 'effects', 'ambiguous', 'before', 'after', 'series',
                           'persistence', 'noise_floor', 'remainder'}
    assert report['plant'] == PLANT.name
    for when in ('before', 'after'):
        assert {kind: set(errors) for kind, errors in report[when].items()} == ERRORS
    assert set(report['remainder']) >= {'white', 'lines_hz', 'depends_on', 'says'}
    assert isinstance(report['remainder']['white'], bool)
    assert report['persistence']['test'] > report['noise_floor'] > 0
    (effect,) = report['effects']
    assert set(effect) >= {'id', 'port', 'parameters', 'p_value', 'share_of_residual', 'certain',
                           'rivals'}
    assert set(effect['parameters']['coulomb']) == {'value', 'unit', 'std_error'}
    assert effect['rivals']
    distances = [rival['delta_bic'] for rival in effect['rivals']]
    assert distances == sorted(distances)
    assert effect['id'] not in {rival['id'] for rival in effect['rivals']}
    assert [series['bag'] for series in report['series']] == [str(files / 'bag')] * 2
    for series in report['series']:
        assert set(series) == {'bag', 'before', 'after'}

    # The repaired model is the one the report speaks of, and it is better on the bag.
    model = read_model(out / 'model.yaml')
    (placed,) = model.effects
    assert placed.named['coulomb'] == effect['parameters']['coulomb']['value']
    assert model.record.reference_rms('free_run') == report['after']['free_run']['test']
    linear = tmp_path / 'linear.yaml'
    assert verb(capsys, 'refit', files / 'bag', '--plant', PLANT.name, '-o', linear)[0] == 0
    before = verb(capsys, 'replay', files / 'bag', '--model', linear)[1]
    after = verb(capsys, 'replay', files / 'bag', '--model', out / 'model.yaml')[1]
    assert after['free_run']['rmse'] < 0.5 * before['free_run']['rmse']

    # From the repaired model on, nothing is missing.
    status, again, _ = verb(capsys, 'trace', files / 'bag', '--plant', PLANT.name, '--model',
                            out / 'model.yaml', '-o', tmp_path / 'again')
    assert status == 0
    assert again == json.loads((tmp_path / 'again' / 'report.json').read_text())
    assert again['verdict'] == 'nothing_missing'
    assert again['before']['free_run']['test'] == pytest.approx(
        report['after']['free_run']['test'], rel=0.02)
    assert read_model(tmp_path / 'again' / 'model.yaml').effects[0].effect.id == 'friction'


@pytest.mark.parametrize(('arguments', 'says'), [
    (['no_such_bag', '--plant', 'load_simulator'], 'no_such_bag'),
    (['{bag}', '--plant', 'windmill'], "no plant 'windmill'"),
    (['{bag}', '--plant', 'load_simulator', '--constant', 'D_m=-1'], 'must be a positive number'),
    (['{bag}', '--plant', 'load_simulator', '--test', 'not_there'], 'not_there'),
    (['{bag}', '--plant', 'load_simulator', '--model', '{folder}/own.yaml'], 'not a model file'),
    (['{bag}', '--plant', 'valve_servo'], '/valve_servo'),
    (['{short}', '--plant', 'load_simulator'], 'no series is long enough'),
    (['{still}', '--plant', 'load_simulator'], 'never moves'),
])
def test_bad_input_is_one_line(tmp_path, capsys, arguments, says):
    signals = load_signals(PLANT.name, [signal.name for signal in PLANT.signals])
    one = record(count=1, duration=0.8).series[0]
    still = replace(one, columns={**one.columns, 'T_g': np.full(len(one), 2.0)})
    (tmp_path / 'own.yaml').write_text('a: 1\n')
    for name, series in (('bag', one), ('short', one.part(0, 60)), ('still', still)):
        if '{' + name + '}' in arguments:
            write_recording(tmp_path / name, [series], signals, {})
    names = {name: tmp_path / name for name in ('bag', 'short', 'still')}
    arguments = [a.format(folder=tmp_path, **names) for a in arguments]
    status, report, err = verb(capsys, 'trace', *arguments, '-o', tmp_path / 'out')
    assert status == 2
    assert report is None
    assert says in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / 'out').exists()


def test_a_file_is_no_folder(tmp_path, capsys):
    (tmp_path / 'out').write_text('mine')
    status, _, err = verb(capsys, 'trace', 'bag', '--plant', PLANT.name, '-o', tmp_path / 'out')
    assert status == 2
    assert 'is a file' in err
    assert (tmp_path / 'out').read_text() == 'mine'


@dataclass(frozen=True)
class Searched:
    """What a search found, as far as the choice between two test parts asks."""

    additions: int
    is_larger_held_out: bool
    tested: str = ''
    error: float = 1.0
    plant: object = PLANT
    after: object = field(default_factory=lambda: SimpleNamespace(candidate=None))


@pytest.mark.parametrize(('again', 'is_second'), [
    (Searched(1, False), True),         # one effect that holds
    (Searched(1, True), False),
    (Searched(2, True), True),
    (Searched(0, False), False),        # nothing may hold where nothing moves
    (Searched(1, False, error=1.3), False),     # for leaving more everywhere
    (Searched(2, True, error=1.3), False),
])
def test_of_two_test_parts_the_one_counts_on_which_the_model_holds(
        monkeypatch, again, is_second):
    """Against two effects that fail on the first third, as many that fail or one that does not."""
    searches = iter([Searched(2, True), again])
    module = importlib.import_module('hydro_twin.inference.trace')
    monkeypatch.setattr(module, '_search', lambda *_: next(searches))
    monkeypatch.setattr(module, '_whole_error', lambda found, _: found.error)
    found = evidence(record(count=3), None, PLANT)
    assert (found.tested != 'third') == is_second
    assert found.additions == (again.additions if is_second else 2)


def test_what_cannot_be_used_is_refused_before_the_search():
    said = []
    whole = record(count=2)
    short = Recording(tuple(one.part(0, 60) for one in whole.series))
    with pytest.raises(DataError):
        trace(whole, None, PLANT, model=Model(PLANT, VALUES, 0.002), earlier=short,
              progress=said.append)
    still = Recording(tuple(replace(one, columns={
        **one.columns, 'T_g': np.zeros(len(one))}) for one in whole.series))
    with pytest.raises(DataError, match=r'^the held-out part: T_g never moves'):
        trace(whole, still, PLANT, progress=said.append)
    assert said == []
