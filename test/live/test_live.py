"""The live twin on serialised messages: what a rig sends, and what a rig must not send."""
from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path

from live_rig import Echo, joint_state, model, PLANT, SIGNALS, Sink, START, STEP
import numpy as np
import pytest

from hydro_twin.errors import ModelError
from hydro_twin.live.diagnostics import Diagnosis, Level
from hydro_twin.live.inputs import TwinInputs
from hydro_twin.live.models import check_same_inputs, choices, load_twin, quick_refusal
from hydro_twin.live.outlet import Outlet
from hydro_twin.live.reader import Reader
from hydro_twin.live.twin import Twin
from hydro_twin.live.writer import Writer
from hydro_twin.model import Model, Noise, Record, write_model
from hydro_twin.plants import PLANTS
from hydro_twin.recording.cdr import CdrError
from hydro_twin.recording.signals import SignalMap


def expected(ks: range) -> list[tuple[int, float, float, float, bool]]:
    return [(START + k * STEP, k, 2 * k, 3 * k, k == ks[0]) for k in ks]


def said(sink: Sink, part: str, publishers: int = 1) -> tuple[Level, str]:
    diagnosis = Diagnosis(sink.live, [])
    statuses = diagnosis.statuses(0, 1.0, {f.topic: publishers for f in sink.live.feeds})
    return next((s.level, s.message) for s in statuses if part in s.part)


def test_messages_become_samples() -> None:
    sink = Sink()
    sink.run(range(50))
    assert sink.samples == expected(range(50))
    assert said(sink, '/joint_states') == (Level.OK, 'receiving')


def sensed() -> Sink:
    """Take the samples of a twin that listens to two sensors, one of them with the joints."""
    signals = SIGNALS | {
        'omega_m': SignalMap('/joint_states', 'sensor_msgs/msg/JointState', 'velocity[0]'),
        'x_v': SignalMap('/spool', 'sensor_msgs/msg/JointState', 'position[0]')}
    return Sink(TwinInputs(PLANT, signals, 0.002, 0.02))


def test_without_the_sensors_that_are_configured_all_is_as_before() -> None:
    """No message has a velocity, and nobody publishes the spool."""
    sink = sensed()
    sink.live.begin({'/command': 1, '/joint_states': 1})
    for k in range(50):
        sink.run([k])
        assert len(sink.samples) == k + 1
    assert sink.samples == expected(range(50))
    assert np.isnan(sink.live.aligner.sensors).all()
    assert said(sink, '/joint_states') == (Level.OK, 'receiving')
    assert said(sink, '/spool', publishers=0) == (Level.OK, 'no such sensor')
    assert said(sink, '/spool', publishers=1) == (Level.WARN, 'no message yet')


def test_a_sensor_that_stops_is_said_and_stops_nothing() -> None:
    sink = sensed()
    read = []
    for k in range(100):
        if k < 40:
            sink.feed(2, joint_state(START + k * STEP, ['spool'], [5 * k]))
        sink.run([k])
        read.append(sink.live.aligner.sensors.tolist())
    assert sink.samples[:80] == expected(range(100))[:80]
    assert len(sink.samples) == 100
    x_v = [sensor.name for sensor in PLANT.sensors].index('x_v')
    assert [row[x_v] for row in read[:40]] == [5.0 * k for k in range(40)]
    assert np.isnan(read[-1]).all()
    diagnosis = Diagnosis(sink.live, [])
    diagnosis.statuses(0, 1.0, {})
    status = next(s for s in diagnosis.statuses(10**9, 1.0, {'/spool': 1}) if '/spool' in s.part)
    assert (status.level, status.message) == (Level.WARN, 'no message for 1.0 s')
    assert status.values['x_v filled'] == '1'


def test_a_sensor_that_contradicts_the_others_is_said() -> None:
    noise = Noise(1.0, {'x_v': 1e-6}, {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01},
                  sensors={'omega_m': 1e-3})
    predictor = replace(model(), noise=noise).predictor()
    twin = Twin('', predictor, 'observer')
    sensors = np.full(len(PLANT.sensors), math.nan)
    for k in range(400):
        sensors[-1] = 0.0 if k < 100 else 10.0
        twin.step(k * STEP, np.zeros(2), 0.0, sensors)
        if not 100 <= k < 110:
            assert twin.sensors == {'omega_m': k < 100}
    assert abs(twin.estimate[0, 2]) < 1e-3
    status = Diagnosis(Sink().live, [twin]).statuses(0, 1.0, {})[-1]
    assert status.level == Level.WARN
    assert status.message == 'omega_m contradicts the other measurements: left out'
    assert status.values['sensors left out'] == 'omega_m'


def test_a_sensor_that_fails_is_no_reason_to_refit() -> None:
    """The residual then grows by half, as the observer expects."""
    rng = np.random.default_rng(1)
    linear = model()
    rate = 2e-4                     # of the spool, by noise on the command
    values = linear.values
    loud = rate * values['K_p'] / values['K_sv'] / math.sqrt(0.002)
    n, t = 40_000, 0.002 * np.arange(40_000)
    inputs = np.column_stack([np.sin(9.0 * t), 0.01 * np.sin(7.0 * t)])
    true = np.empty((n, len(linear.system.step.H)))
    y = linear.system.run(inputs + loud * rng.normal(size=n)[:, None] * [1.0, 0.0],
                          np.zeros(PLANT.order), seen=true)
    sensors = np.full((n, len(PLANT.sensors)), math.nan)
    sensors[:, -1] = true[:, -1] + 5e-3 * rng.normal(size=n)
    measured = y + 0.5 * rng.normal(size=n)
    noise = Noise(0.5, {'x_v': rate}, dict.fromkeys(PLANT.states, 0.0),
                  sensors={'omega_m': 5e-3})
    sound = replace(linear, noise=noise).predictor()
    results, _ = sound.filter.run(inputs, np.column_stack([measured, sensors]))     # type: ignore
    reference_rms = float(np.sqrt(np.mean((measured - results[:, 0])[:10_000] ** 2)))
    innovation = float(np.sqrt(np.mean(results[:10_000, 1])))
    sensors[20_000:] = math.nan
    for expected, rises in ((innovation, False), (None, True)):
        twin = Twin('', replace(
            linear, noise=replace(noise, innovation=expected),
            record=Record(errors={'after': {'observer': {'test': reference_rms}}})).predictor(),
            'observer')
        residuals = []
        for k in range(n):
            twin.step(k * STEP, inputs[k], measured[k], sensors[k])
            residuals.append(twin.residual)
            if k % 500 == 0:
                twin.judge()
        assert twin.monitor is not None
        assert (twin.monitor.rise is not None) == rises
        assert np.std(residuals[21_000:]) > 1.3 * np.std(residuals[1000:20_000])


def test_joints_may_change_places_and_messages_their_size() -> None:
    sink = Sink()
    for k in range(40):
        sink.feed(0, joint_state(START + k * STEP, ['valve'], [k], frame='rig' * (k % 3)))
        names, position, effort = ['shaft', 'other'], [2 * k, -1], [3 * k, -1]
        turn = 1 if k % 2 else -1
        sink.feed(1, joint_state(START + k * STEP, names[::turn], position[::turn],
                                 effort[::turn]))
    assert sink.samples == expected(range(40))


def test_messages_about_other_joints_are_none_of_ours() -> None:
    sink = Sink()
    for k in range(40):
        sink.run([k])
        sink.feed(1, joint_state(START + k * STEP + 5, ['gripper'], [1.0], [1.0]))
    assert sink.samples == expected(range(40))
    assert said(sink, '/joint_states')[0] == Level.OK


def test_a_joint_that_never_comes_is_said() -> None:
    sink = Sink()
    for k in range(40):
        sink.feed(0, joint_state(START + k * STEP, ['valve'], [k]))
        sink.feed(1, joint_state(START + k * STEP, ['wrong'], [k], [k]))
    assert not sink.samples
    assert said(sink, '/joint_states') == (
        Level.ERROR, 'no message holds theta_d; no message holds T_g')


@pytest.mark.parametrize('payload', [
    joint_state(START, ['shaft'], [1.0]),                    # no effort
    joint_state(START, ['other', 'shaft'], [1.0], [1.0]),    # arrays too short
    joint_state(START, ['shaft'], [1.0], [1.0])[:-9], b'', b'\x00\x01\x00\x00',
])
def test_a_malformed_message_is_counted_and_said(payload: bytes) -> None:
    sink = Sink()
    sink.run(range(20))
    sink.feed(1, payload)
    sink.run(range(20, 40))
    assert sink.samples == expected(range(40))
    level, message = said(sink, '/joint_states')
    assert level == Level.WARN
    assert message.startswith('1 malformed: ')


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_bridged_and_said(bad: float) -> None:
    sink = Sink()
    sink.run(range(20))
    sink.feed(0, joint_state(START + 20 * STEP, ['valve'], [20]))
    sink.feed(1, joint_state(START + 20 * STEP, ['shaft'], [bad], [60.0]))
    sink.run(range(21, 40))
    assert sink.samples == expected(range(40))   # interpolated between 19 and 21
    assert said(sink, '/joint_states') == (Level.WARN, 'theta_d: 1 not finite')


def test_a_pause_of_100_ms_begins_anew() -> None:
    sink = Sink()
    sink.run(range(100))
    sink.run(range(150, 300))
    assert sink.ks == [*range(100), *range(100, 105), *range(150, 300)][:100] + \
        list(range(150, 300))
    assert sink.firsts == [0, 150]


def test_a_burst_after_a_stall_loses_nothing() -> None:
    sink = Sink()
    for k in range(200):
        sink.feed(0, joint_state(START + k * STEP, ['valve'], [k]))
        if k == 100:
            for silence in range(0, 10**9, 20_000_000):   # while a sample is half there
                sink.tick(10**9 + silence)
        sink.feed(1, joint_state(START + k * STEP, ['shaft'], [2 * k], [3 * k]))
    assert sink.samples == expected(range(200))


def test_a_publisher_that_dies_and_returns() -> None:
    sink = Sink()
    sink.run(range(100))
    for age in range(0, 3_000_000_000, 20_000_000):
        sink.tick(10**12 + age)
    assert sink.ks == list(range(100))             # nothing is made up meanwhile
    assert said(sink, '/command')[0] == Level.OK   # since the counters began
    sink.run(range(2000, 2100))
    assert sink.ks[-100:] == list(range(2000, 2100))
    assert sink.firsts == [0, 2000]


def test_a_dead_topic_is_stale() -> None:
    sink = Sink()
    sink.run(range(10))
    diagnosis = Diagnosis(sink.live, [])
    diagnosis.statuses(0, 1.0, {})
    statuses = diagnosis.statuses(5 * 10**9, 1.0, {})
    assert [s.level for s in statuses[:2]] == [Level.STALE, Level.STALE]


def test_only_malformed_messages_are_an_error_after_good_ones_too() -> None:
    sink = Sink()
    sink.run(range(20))
    diagnosis = Diagnosis(sink.live, [])
    diagnosis.statuses(0, 1.0, {})
    for _ in range(5):
        sink.feed(1, b'')
    levels = {s.part: s.level for s in diagnosis.statuses(0, 1.0, {})}
    assert levels['input /joint_states'] == Level.ERROR
    sink.run(range(20, 40))
    levels = {s.part: s.level for s in diagnosis.statuses(0, 1.0, {})}
    assert levels['input /joint_states'] == Level.OK


@pytest.mark.parametrize('pause', [1.003, 5.0])
def test_a_slow_topic_is_silent_only_after_some_of_its_pauses(pause: float) -> None:
    second = 10 ** 9
    live = TwinInputs(PLANT, SIGNALS, pause, 0.1)
    twin = Twin('', Echo(model(), sample_time=pause), 'one_step')
    diagnosis = Diagnosis(live, [twin])
    levels: list[Level] = []
    sent, last = 0, 0.0
    for now in range(1, 140):
        while sent * pause <= min(now, 100):
            last = sent * pause
            stamp = START + round(last * second)
            for feed, payload in zip(live.feeds, (
                    joint_state(stamp, ['valve'], [1.0]),
                    joint_state(stamp, ['shaft'], [1.0], [1.0])), strict=True):
                live.take(feed, payload, lambda: 0)
            live.tick(round(last * second))
            twin.step(stamp, np.zeros(2), 1.0)
            sent += 1
        statuses = diagnosis.statuses(now * second, 1.0, {})
        if now > 2 * pause:
            levels.append(max(s.level for s in statuses if s.part != 'time'))
            if now > last + 3.0 * pause:
                assert [s.level for s in statuses if s.part.startswith('input')] == [
                    Level.STALE, Level.STALE]
                assert statuses[-1].message == 'no predictions: waiting for inputs'
    assert set(levels[:90]) == {Level.OK}
    assert levels[-1] == Level.STALE


def test_missing_predictions_are_said_but_not_one_more_or_less() -> None:
    twin = Twin('', Echo(model(), sample_time=0.5), 'one_step')
    diagnosis = Diagnosis(TwinInputs(PLANT, SIGNALS, 0.5, 0.1), [twin])
    for made, level in ((0, Level.WARN), (3, Level.OK), (1, Level.OK), (0, Level.WARN)):
        twin.predictions += made
        assert diagnosis.statuses(0, 1.0, {})[-1].level == level
    fast = Twin('', Echo(model()), 'one_step')
    diagnosis.replace([fast])
    fast.predictions += 400
    assert diagnosis.statuses(0, 1.0, {})[-1].message == '400.0 of 500 predictions a second'


def test_the_counters_go_on_where_a_twin_is_replaced() -> None:
    sink = Sink()
    twins = [Twin(name, Echo(model()), 'one_step') for name in ('', 'other', '')]
    diagnosis = Diagnosis(sink.live, twins[:2])
    sink.run(range(500))
    sink.feed(1, b'')
    diagnosis.statuses(0, 1.0, {})
    sink.run(range(500, 1000))
    diagnosis.replace(twins[2:])
    assert list(diagnosis.twins) == [twins[2], twins[1]]
    statuses = diagnosis.statuses(0, 1.0, {})
    assert [(s.values['rate [Hz]'], s.message) for s in statuses[:2]] == [
        ('500.0', 'receiving'), ('500.0', 'receiving')]
    assert twins[0] not in {owner for owner, _ in diagnosis._last}


def test_two_publishers_on_one_topic_are_said() -> None:
    sink = Sink()
    for k in range(50):
        sink.run([k])
        sink.feed(1, joint_state(START + k * STEP - 500_000, ['shaft'], [0.0], [0.0]))
    assert sink.ks == list(range(50))
    level, message = said(sink, '/joint_states', publishers=2)
    assert level == Level.WARN
    assert '2 publishers on one topic' in message
    assert 'out of order' in message


def test_a_clock_that_jumps_back_is_said() -> None:
    sink = Sink()
    sink.run(range(1000, 1050))
    sink.run(range(50))
    assert sink.firsts == [1000, 0]
    assert said(sink, 'time') == (Level.WARN, 'reset: stamps of u_m jumped back')


def test_without_a_stamp_the_arrival_counts() -> None:
    signals = {n: SignalMap(f'/{n}', 'std_msgs/msg/Float64', 'data') for n in SIGNALS}
    sink = Sink(TwinInputs(PLANT, signals, 0.002, 0.1))
    for k in range(30):
        for topic in range(3):
            payload = joint_float(float(k))
            sink.feed(topic, payload, START + k * STEP)
    assert sink.ks == list(range(30))


def joint_float(value: float) -> bytes:
    from live_rig import STORE
    kind = 'std_msgs/msg/Float64'
    return bytes(STORE.serialize_cdr(STORE.types[kind](value), kind))


def test_scale_and_offset_apply() -> None:
    signal = SignalMap('/a', 'sensor_msgs/msg/JointState', 'position[0]', 2.0, 1.0)
    assert Reader([signal]).read(joint_state(START, ['a'], [3.0])) == (START, [7.0])
    with pytest.raises(CdrError, match='has 1 numbers'):
        Reader([SignalMap('/a', 'sensor_msgs/msg/JointState', 'position[1]')]).read(
            joint_state(START, ['a'], [3.0]))


def test_bytes_after_the_end_do_not_matter() -> None:
    signal = SignalMap('/a', 'sensor_msgs/msg/JointState', 'position[0]')
    payload = joint_state(START, ['a'], [3.0])
    assert Reader([signal]).read(payload + b'some more') == (START, [3.0])


def ignore(payload: bytes) -> None:
    """Publish on a topic that a test does not look at."""


def test_the_writer_writes_what_the_reader_reads() -> None:
    for unit, field in (('N m', 'effort'), ('m', 'position'), ('rad/s', 'velocity')):
        payload = Writer(['T_g'], unit).write(START, 1.25)
        signal = SignalMap('/a', 'sensor_msgs/msg/JointState', f'{field}[T_g]')
        assert Reader([signal]).read(payload) == (START, [1.25])
    payload = Writer(['v', 'v_std'], '').write(START, 1.5, 0.25)
    both = [SignalMap('/a', 'sensor_msgs/msg/JointState', f'position[{name}]')
            for name in ('v', 'v_std')]
    assert Reader(both).read(payload) == (START, [1.5, 0.25])


def test_a_twin_that_diverges_is_reset_and_publishes_nothing() -> None:
    echo = Echo(model(), gain=100.0)
    twin = Twin('', echo, 'free_run')
    sent: list[bytes] = []
    outlet = Outlet(twin, 1, sent.append, ignore, ignore, ignore, ignore)
    for k in range(100):
        outlet.step(k * STEP, [0.0, 0.0], 1.0)   # type: ignore[arg-type]
    read = Reader([SignalMap('/a', 'sensor_msgs/msg/JointState', 'effort[0]')]).read
    assert twin.divergences > 10
    assert echo.started == 1 + twin.divergences
    assert max(abs(read(payload)[1][0] or 0.0) for payload in sent) < 1e6


@pytest.mark.parametrize('mode', ['observer', 'one_step', 'free_run'])
def test_a_twin_recovers_from_a_sensor_that_is_wild_for_some_samples(mode: str) -> None:
    """A run that was begun anew on such a sample has diverged before its first prediction."""
    cylinder = PLANTS['cylinder']
    made = Model(cylinder, {'tau': 0.05, 'K_v': 0.1}, 0.01, noise=Noise(
        1e-5, {'q': 1e-4, 'x': 1e-4}, {'q': 0.1, 'x': 0.1}))
    twin = Twin('', made.predictor(), mode)
    for k in range(100):
        measured = 1e12 if 50 <= k < 53 else 0.2
        predicted = twin.step(k * 10_000_000, np.zeros(1), measured)
        assert k < 50 or math.isnan(predicted) or abs(predicted) < 1e6
    assert predicted == pytest.approx(0.2, abs=1e-3)


def test_a_missing_measurement_leaves_no_residual() -> None:
    twin = Twin('', Echo(model()), 'one_step')
    residuals: list[bytes] = []
    predictions: list[bytes] = []
    outlet = Outlet(twin, 1, predictions.append, residuals.append, ignore, ignore, ignore)
    for measured in (1.0, 1.0, math.nan):
        outlet.step(0, [0.0, 0.0], measured)   # type: ignore[arg-type]
    assert (len(predictions), len(residuals)) == (2, 1)


def test_a_twin_that_takes_over_costs_no_prediction() -> None:
    """It is published once it predicts; what it starts with is made by the one before."""
    sent: list[bytes] = []
    outlet = Outlet(Twin('', Echo(model()), 'one_step'), 1, sent.append, ignore, ignore, ignore,
                    ignore)
    for k in range(20):
        if k == 10:
            outlet.exchange(Twin('', Echo(model(), gain=2.0), 'one_step'))
        outlet.step(k * STEP, [0.0, 0.0], 1.0)   # type: ignore[arg-type]
    read = Reader([SignalMap('/a', 'sensor_msgs/msg/JointState', 'effort[0]')]).read
    later = 10 - 1 + PLANT.order
    assert [read(payload)[1][0] for payload in sent] == [1.0] * later + [2.0] * (19 - later)


def test_a_model_that_no_longer_holds_is_said() -> None:
    twin = Twin('', Echo(model(reference_rms=1.0)), 'one_step')
    assert twin.monitor is not None
    rng = np.random.default_rng(0)
    for k, e in enumerate(rng.normal(0.0, 2.0, 40 * 500).tolist()):
        twin.monitor.add(k * STEP, e)
    twin.predictions = 500
    twin.monitor.judge()
    said_of = Diagnosis(Sink().live, [twin]).statuses(0, 1.0, {})[-1]
    assert said_of.level == Level.WARN
    assert said_of.message.startswith('refit: the RMS of the residual is 2.')
    assert 'record data like that from stamp 0.000' in said_of.message
    twin.start_over()
    assert twin.monitor.rise is None


def test_models_are_named(tmp_path: object) -> None:
    named = choices('a.yaml', ['b=c.yaml', 'some-model.yaml', ''])
    assert [choice.name for choice in named] == ['', 'b', 'some_model']
    for bad in (('', []), ('', ['a.yaml', 'b/a.yaml']), ('', ['1=a.yaml'])):
        with pytest.raises(ModelError):
            choices(*bad)


def test_a_model_of_another_plant_is_refused(tmp_path) -> None:   # type: ignore[no-untyped-def]
    good = tmp_path / 'good.yaml'
    write_model(model(), good)
    assert quick_refusal(good, 'load_simulator') == ''
    assert 'the node runs cylinder' in quick_refusal(good, 'cylinder')
    assert 'No such file' in quick_refusal(tmp_path / 'absent.yaml', 'cylinder')
    (tmp_path / 'noise').write_bytes(b'\xff\x00' * 50)
    assert 'not a model file' in quick_refusal(tmp_path / 'noise', 'load_simulator')
    twin = load_twin(choices(str(good), [])[0], 'one_step')
    slow = Twin('slow', Echo(model(), sample_time=0.01), 'one_step')
    with pytest.raises(ModelError, match='sample_time'):
        check_same_inputs(slow, twin)


@pytest.mark.parametrize(('noise', 'mode'), [
    (None, 'one_step'),
    (Noise(0.6, dict.fromkeys(PLANT.states, 0.1), dict.fromkeys(PLANT.states, 1.0)), 'observer')])
def test_a_model_that_lacks_its_noise_runs_one_step_in_place_of_the_observer(
        tmp_path: Path, noise: Noise | None, mode: str) -> None:
    path = tmp_path / 'model.yaml'
    write_model(replace(model(), noise=noise), path)
    assert load_twin(choices(str(path), [])[0], 'observer').mode == mode
