"""The node and the player as real processes over DDS."""
from __future__ import annotations

from itertools import pairwise
import json
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from lifecycle_msgs.msg import Transition  # noqa: E402,I100
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rcl_interfaces.srv import GetParameters, SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from ros_rig import (  # noqa: E402
    ended,
    INPUTS,
    lossless,
    OUTPUTS,
    PATIENCE,
    play,
    process,
    Rig,
    stamp_of,
    twin,
)
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from hydro_twin.model import load_predictor, Model, Noise, Record, write_model  # noqa: E402
from hydro_twin.plants import plant_named  # noqa: E402
from hydro_twin.recording.read import read_recording  # noqa: E402
from hydro_twin.recording.series import Series  # noqa: E402
from hydro_twin.recording.signals import load_signals  # noqa: E402
from hydro_twin.recording.write import write_recording  # noqa: E402

pytestmark = [pytest.mark.slow,   # what rclpy imports imports what is out of date
              pytest.mark.filterwarnings("ignore:module 'sre_")]

PLANT = plant_named('load_simulator')
NAMES = [s.name for s in PLANT.signals]
START = 1_700_000_000_123_456_789
STEP = 2_000_000


MODES = ('one_step', 'free_run', 'observer')
NOISE = Noise(1.0, {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1},
              {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01})


def make_model(path: Path, **changes: float) -> Path:
    values = {p.name: (p.lower * p.upper)**0.5 for p in PLANT.parameters} | changes
    write_model(Model(PLANT, PLANT.constant_values() | values, PLANT.sample_time, noise=NOISE,
                      record=Record(errors={'after': {m: {'test': 3.0} for m in MODES}})),
                path)
    return path


def make_series(samples: int, start: int = START) -> Series:
    time_ = np.arange(samples) * 0.002
    rng = np.random.default_rng(3)
    return Series({'u_m': np.sin(2 * np.pi * 7 * time_), 'theta_d': 0.01 * np.sin(9 * time_),
                   'T_g': 30 * np.sin(2 * np.pi * 7 * time_ - 1) + rng.normal(size=samples)},
                  0.002, start)


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_model(tmp_path_factory.mktemp('models') / 'linear.yaml')


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two stretches with a pause, the second long enough for the network to hiccup."""
    path = tmp_path_factory.mktemp('bags') / 'bag'
    write_recording(path, [make_series(500), make_series(1000, START + 2000 * STEP)],
                    load_signals('load_simulator', NAMES))
    return path


@pytest.mark.parametrize(('rate', 'mode'), [(1.0, 'observer'), *((4.0, mode) for mode in MODES)])
def test_live_is_replay_to_the_last_digit(rig: Rig, bag: Path, model: Path, mode: str,
                                          rate: float) -> None:
    predictions = rig.listen('/hydro_twin/prediction', JointState)
    residuals = rig.listen('/hydro_twin/residual', JointState)
    predictor = load_predictor(model)
    recording = read_recording([bag], load_signals('load_simulator', NAMES), ['u_m'], 0.002)
    expected = {series.start + k * STEP: (y, series['T_g'][k] - y)
                for series in recording.series
                for k, y in enumerate(getattr(predictor, mode)(series).tolist()) if y == y}
    assert len(recording.series) == 2
    with twin(model=model, mode=mode, **lossless()):
        rig.ready()
        play(bag, '--rate', str(rate))
        rig.until(lambda: len(residuals) >= len(expected), 'all is predicted')
    assert [stamp_of(m) for m in predictions] == list(expected)
    assert [m.effort[0] for m in predictions] == [y for y, _ in expected.values()]
    assert [m.effort[0] for m in residuals] == [e for _, e in expected.values()]


def test_the_observer_publishes_the_states_that_nobody_measures(rig: Rig, bag: Path, model: Path
                                                                ) -> None:
    states = rig.listen('/hydro_twin/states', JointState)
    ahead = rig.listen('/hydro_twin/ahead', JointState)
    parameters = rig.listen('/hydro_twin/parameters', JointState)
    predictor: Any = load_predictor(model, follow=['B_m=0.3'])
    observer = predictor.filter
    recording = read_recording([bag], load_signals('load_simulator', NAMES), ['u_m'], 0.002)
    expected, later, followed = {}, {}, {}
    for series in recording.series:
        inputs = np.column_stack([series[name] for name in ('u_m', 'theta_d')])
        _, estimates = observer.run(inputs, series['T_g'], True)
        for k, estimate in enumerate(estimates):
            expected[series.start + k * STEP] = estimate[:, :-1].ravel().tolist()
            followed[series.start + k * STEP] = observer.followed.in_units(
                estimate[:, -1:]).ravel().tolist()
        stepper = predictor.stepper('observer')
        for k, row in enumerate(zip(inputs, series['T_g'].tolist(), strict=True)):
            stepper.step(*row)
            later[series.start + (k + 20) * STEP] = stepper.ahead(20)
    with twin(model=model, horizon=20, follow=['B_m=0.3'], **lossless(
            outputs=[*OUTPUTS, '/hydro_twin/states', '/hydro_twin/ahead',
                     '/hydro_twin/parameters'])):
        rig.ready()
        play(bag)
        rig.until(lambda: len(states) >= len(expected) and len(ahead) >= len(later)
                  and len(parameters) >= len(followed), 'all is estimated')
    assert [(stamp_of(m), *m.effort) for m in ahead] == [(k, *both) for k, both in later.items()]
    assert ahead[0].name == ['T_g', 'T_g_std']
    assert [stamp_of(m) for m in states] == list(expected)
    names = [*observer.names]
    assert names[:4] == ['x_v', 'p_L', 'omega_j', 'theta_j']
    assert states[0].name == [*names, *(f'{name}_std' for name in names)]
    assert parameters[0].name == ['B_m', 'B_m_std']
    assert {stamp_of(m): m.position.tolist() for m in parameters} == followed
    assert [m.position.tolist() for m in states] == list(expected.values())
    assert all(deviation > 0.0 for m in states
               for deviation in m.position[len(names):len(names) + 4])


def set_parameter(rig: Rig, name: str, value: object) -> Any:
    return rig.call(SetParameters, '/hydro_twin/set_parameters', SetParameters.Request(
        parameters=[Parameter(name, value=value).to_parameter_msg()])).results[0]


def events(heard: list[String]) -> list[dict[str, Any]]:
    return [json.loads(message.data) for message in heard]


def test_models_run_side_by_side_and_are_exchanged_or_refused_while_they_run(
        rig: Rig, tmp_path: Path, bag: Path) -> None:
    first = make_model(tmp_path / 'first.yaml')
    stiff = make_model(tmp_path / 'stiff.yaml', G=1.4e4)
    broken = tmp_path / 'broken.yaml'
    broken.write_text(first.read_text().replace('J:', 'JJ:'))
    info = rig.listen('/hydro_twin/model_info', String, latched=True)
    happened = rig.listen('/hydro_twin/model_event', String)
    mains = rig.listen('/hydro_twin/prediction', JointState)
    stiffs = rig.listen('/hydro_twin/stiff/prediction', JointState)
    with twin(model=first, models=f'[{stiff}]', mode='free_run', **lossless()):
        rig.ready()
        described = json.loads(rig.until(lambda: info, 'the models are described')[-1].data)
        assert [(d['name'], d['plant'], len(d['sha256'])) for d in described] == \
            [('', 'load_simulator', 64), ('stiff', 'load_simulator', 64)]
        with process('hydro_twin.commands.main', 'replay', str(bag), '--publish', '--loop'):
            rig.until(lambda: len(mains) > 100, 'something is predicted')

            refused = set_parameter(rig, 'model', str(tmp_path / 'absent.yaml'))
            assert not refused.successful
            assert 'No such file' in refused.reason
            assert not set_parameter(rig, 'mode', 'two_step').successful
            assert not set_parameter(rig, 'models', ['x.yaml']).successful

            assert set_parameter(rig, 'model', str(broken)).successful   # it looks like a model
            rig.until(lambda: [e for e in events(happened) if e['event'] == 'refused'],
                      'the broken model is refused')
            rig.until(lambda: rig.call(
                GetParameters, '/hydro_twin/get_parameters',
                GetParameters.Request(names=['model'])).values[0].string_value == str(first),
                'the parameter is what it was')
            first.unlink()   # the file of the running model vanishes
            count = len(mains)
            rig.until(lambda: len(mains) > count + 100, 'the old model still runs')

            assert set_parameter(rig, 'model', str(stiff)).successful
            rig.until(lambda: [e for e in events(happened) if e['event'] == 'swapped'],
                      'the other model takes over')
            mains.clear()
            stiffs.clear()
            # Once the bag has begun anew, both have run on the same samples from one start.
            rig.until(lambda: [m for m in mains if stamp_of(m) == START], 'the bag begins anew')
            begun = next(k for k, m in enumerate(mains) if stamp_of(m) == START)
            rig.until(lambda: len(mains) > begun + 400 and len(stiffs) > 400, 'more comes')
            twins = {stamp_of(m): m.effort[0] for m in stiffs}
            shared = [(m.effort[0], twins[stamp_of(m)]) for m in mains[begun:begun + 300]
                      if stamp_of(m) in twins]
            assert len(shared) > 200
            assert all(main == stiff for main, stiff in shared)


def test_the_node_obeys_a_lifecycle_manager_and_resets(rig: Rig, model: Path, bag: Path) -> None:
    predictions = rig.listen('/hydro_twin/prediction', JointState)

    def state() -> str:
        return rig.call(GetState, '/hydro_twin/get_state', GetState.Request()).current_state.label

    def change(label: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = label
        return rig.call(ChangeState, '/hydro_twin/change_state', request).success

    with twin(model=model.with_name('absent.yaml'), autostart=False, **lossless()):
        assert state() == 'unconfigured'
        for none in (Transition.TRANSITION_ACTIVATE, 99):     # by id, as managers ask
            request = ChangeState.Request(transition=Transition(id=none))
            assert not rig.call(ChangeState, '/hydro_twin/change_state', request).success
        assert not change('configure')
        assert state() == 'unconfigured'
        assert set_parameter(rig, 'model', str(model)).successful
        assert change('configure')
        assert state() == 'inactive'
        assert change('activate')
        for _ in range(2):
            rig.ready()
            predictions.clear()
            play(bag, '--rate', '4')
            rig.until(lambda: len(predictions) == 1500 - 2 * PLANT.order, 'it predicts')
            assert change('deactivate')
            assert change('activate')
        reset = rig.call(Trigger, '/hydro_twin/reset', Trigger.Request())
        assert reset.success
        rig.ready()
        predictions.clear()
        play(bag, '--rate', '4')
        rig.until(lambda: len(predictions) == 1500 - 2 * PLANT.order, 'it predicts after a reset')
        assert change('deactivate')
        assert change('cleanup')
        assert state() == 'unconfigured'
        assert set_parameter(rig, 'signals.T_g.topic', '/elsewhere').successful
        assert change('configure')
        assert change('activate')
        rig.ready(['/elsewhere'])


def test_played_with_a_clock_in_a_loop_it_resets_at_the_jump(rig: Rig, bag: Path, model: Path,
                                                             ) -> None:
    predictions = rig.listen('/hydro_twin/prediction', JointState)
    with twin(model=model, mode='free_run', use_sim_time=True, **lossless()):
        rig.ready(['/clock', *INPUTS])
        with process('hydro_twin.commands.main', 'replay', str(bag), '--publish', '--loop',
                     '--clock', '--rate', '4'):
            rig.status('time', 'jumped back')
            rig.until(lambda: len(predictions) > 3500, 'it goes on')
    stamps = [stamp_of(m) for m in predictions]
    assert max(stamps) < START + 3500 * STEP
    assert sum(later < earlier for earlier, later in pairwise(stamps)) >= 1


def test_played_slowly_by_the_clock_it_keeps_its_rate(rig: Rig, bag: Path, model: Path) -> None:
    """500 predictions a second of the bag are all there can be, however long that second is."""
    def keeps_its_rate() -> bool:
        return any(400.0 < float(value.value) < 550.0 for message in rig.heard['/diagnostics']
                   for status in message.status if status.name.endswith(': model main')
                   for value in status.values if value.key == 'rate [Hz]')

    with twin(model=model, use_sim_time=True, **lossless()):
        rig.ready(['/clock', *INPUTS])
        with process('hydro_twin.commands.main', 'replay', str(bag), '--publish', '--loop',
                     '--clock', '--rate', '0.5'):
            rig.until(keeps_its_rate, 'it says that it keeps its rate')
    assert keeps_its_rate()


def test_the_player_ends_when_interrupted_and_offers_no_service(rig: Rig, bag: Path) -> None:
    rig.listen(INPUTS[0], JointState)
    with subprocess.Popen([sys.executable, '-m', 'hydro_twin.commands.main', 'replay', str(bag),
                           '--publish', '--loop', '--json'], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as player, ended(player):
        rig.until(lambda: len(rig.heard[INPUTS[0]]) > 101, 'it plays')   # one may not be counted
        assert not rig.node.get_service_names_and_types_by_node('hydro_twin_player', '/')
        player.send_signal(signal.SIGINT)
        out, err = player.communicate(timeout=PATIENCE)
    assert player.returncode == 0, err
    assert json.loads(out)['played'][INPUTS[0]] > 100


def test_the_player_takes_ros_arguments(rig: Rig, bag: Path) -> None:
    heard = rig.listen('/rig/command', JointState)
    done = subprocess.run(
        [sys.executable, '-m', 'hydro_twin.commands.main', 'replay', str(bag), '--publish',
         '--json', '--rate', '4', '--ros-args', '-r', '/load_simulator/command:=/rig/command',
         '-r', '__node:=player', '-r', '__ns:=/rig'], capture_output=True, text=True, check=True,
        timeout=PATIENCE)
    assert set(json.loads(done.stdout)['played']) == {'/rig/command', INPUTS[1]}
    rig.until(lambda: heard, 'something came on the other topic')


@pytest.mark.parametrize('seconds', [0.5, 1.0, 1.5])
def test_interrupted_while_it_starts_it_ends_quietly(model: Path, seconds: float) -> None:
    """Not timed: wherever it is by then, on whatever machine, it ends quietly."""
    with subprocess.Popen([sys.executable, '-m', 'hydro_twin.commands.main', 'node', '--ros-args',
                           '-p', f'model:={model}'], stderr=subprocess.PIPE, text=True
                          ) as node, ended(node):
        time.sleep(seconds)
        node.send_signal(signal.SIGINT)
        _, err = node.communicate(timeout=PATIENCE)
    # Before it takes the signal itself it ends as any program of Python's, by the signal or with
    # the status that shells give for it; after that with 0. Never with a traceback, whose is 1.
    assert node.returncode in (0, 130, -signal.SIGINT), err
    assert not re.search('rror|Traceback', err)
    if node.returncode:
        assert err == 'hydro-twin node: interrupted\n'


INTERRUPTED_IN_A_CALLBACK = """
import os, signal, sys, weakref

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == 'rclpy':
            sys.meta_path.remove(self)
            lost = set()
            self.reference = weakref.ref(lost, lambda _: os.kill(os.getpid(), signal.SIGINT))

sys.meta_path.insert(0, Interrupting())
from hydro_twin.commands.main import main
sys.exit(main(sys.argv[1:]))
"""


def test_an_interrupt_is_not_lost_in_a_callback_of_an_import(model: Path) -> None:
    """Python ignores what is raised there: the node has to remember the signal."""
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPTED_IN_A_CALLBACK, 'node', '--ros-args', '-p',
         f'model:={model}'], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0
    assert 'ignored' not in done.stderr


@pytest.mark.parametrize(('arguments', 'named'), [
    (['-p', 'model:=absent.yaml'], 'absent.yaml'),
    (['-p', 'mode:=two_step'], 'two_step'),
    (['-p', 'wait:=20.0'], 'wait'),
    (['-p', 'wait:=long'], 'wait'),
    (['-p', 'signals.T_g.topic:=3'], 'signals.T_g.topic'),
    (['-p', 'signals.T_g.topic:=/a-b'], '/a-b'),
    (['-p', 'qos_overrides./hydro_twin/model_info.publisher.history:=some'], 'model_info'),
    (['--params-file', 'absent.yaml'], 'absent.yaml')])
def test_a_bad_start_is_one_line(model: Path, arguments: list[str], named: str) -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'hydro_twin.commands.main', 'node', '--ros-args', '-p',
         f'model:={model}', *arguments],
        capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    *before, line = done.stderr.splitlines()
    assert line.startswith('hydro-twin node: ')
    assert named in line
    assert all('[rcl]' in said for said in before)   # which speaks for itself
