"""The loop as real processes: a rig that begins to rub, its twin, and `keep` beside it."""
from __future__ import annotations

import json
from pathlib import Path
import subprocess
import sys
from typing import Any

import pytest

pytest.importorskip('rclpy')

from rcl_interfaces.srv import GetParameters  # noqa: E402
from ros_rig import ended, process, Rig, twin  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Empty, String  # noqa: E402

from hydro_twin.recording.read import read_recording  # noqa: E402
from hydro_twin.recording.signals import load_signals  # noqa: E402
from hydro_twin.ros.worn_rig import COULOMB, first_model, NOISE, PLANT, STEP  # noqa: E402
from hydro_twin.store.store import Store  # noqa: E402

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:module 'sre_")]

PATIENCE = 1200.0   # s; a trace on a busy machine takes minutes, and messages queue up meanwhile
INPUTS = ('/load_simulator/command', '/load_simulator/joint_states')
RELIABLE: dict[str, object] = {
    f'qos_overrides.{topic}.subscription.{policy}': value for topic in INPUTS
    for policy, value in (('reliability', 'reliable'), ('depth', 20_000))}
KEEP = '/hydro_twin_keep'


def flags(**parameters: object) -> list[str]:
    return ['--ros-args', *(word for name, value in parameters.items()
                            for word in ('-p', f'{name}:={value}'))]


def happened(heard: list[String], event: str) -> Any:
    return next((about for message in heard
                 if (about := json.loads(message.data))['event'] == event), None)


def rms(messages: list[JointState]) -> float:
    return float((sum(m.effort[0] ** 2 for m in messages) / len(messages)) ** 0.5)


def parameter(rig: Rig, name: str) -> str:
    return str(rig.call(GetParameters, '/hydro_twin/get_parameters',
                        GetParameters.Request(names=[name])).values[0].string_value)


def test_an_effect_appears_and_a_model_that_names_it_runs(rig: Rig, tmp_path: Path) -> None:
    first, store = first_model(tmp_path / 'first.yaml'), Store(tmp_path / 'store')
    events = rig.listen(f'{KEEP}/event', String)
    models = rig.listen('/hydro_twin/model_event', String)
    residuals = rig.listen('/hydro_twin/residual', JointState)
    rub = rig.node.create_publisher(Empty, '/wear', 10)
    reason = rig.node.create_publisher(String, f'{KEEP}/capture', 10)
    keep = ['hydro_twin.commands.main', 'keep', *flags(
        store=store.path, before=60, after=4, nice=0, trial_least=2, **RELIABLE)]
    # No faster than real time: at twice that, rig, node and keep take 1.7 cores of a slow machine,
    # and beside other tests two cores hear the rig later and later.
    with subprocess.Popen([sys.executable, '-m', 'hydro_twin.ros.worn_rig']) as publisher, \
            ended(publisher), \
            twin(model=first, mode='free_run', **RELIABLE):
        with process(*keep, '-p', 'policy:=auto'):
            rig.ready()
            rig.until(lambda: rig.node.count_publishers(INPUTS[0]), 'the rig publishes')
            # What the twin learns the colour of its residual from.
            rig.until(lambda: len(residuals) > 17_000, 'the healthy rig was watched', PATIENCE)
            assert not events
            assert store.champion is not None      # what the twin ran
            assert store.champion.model_file.read_bytes() == first.read_bytes()
            rub.publish(Empty())
            rig.until(lambda: happened(events, 'captured'), 'a stretch is captured', PATIENCE)
            traced = rig.until(lambda: happened(events, 'traced'), 'it is traced', PATIENCE)
            assert 'motor friction' in traced['changed']
            promoted = rig.until(lambda: happened(events, 'promoted'), 'it is better', PATIENCE)
            assert promoted['by'] == 'keep, policy auto'
            champion = store.champion
            assert champion.name == promoted['version'] == '0002'
            (placed,) = champion.model().effects
            assert placed.effect.id == 'friction'
            assert placed.named['coulomb'] == pytest.approx(COULOMB, rel=0.1)
            rig.until(lambda: parameter(rig, 'model') == str(champion.model_file),
                      'the twin is set to it', PATIENCE)
            rig.until(lambda: happened(events, 'confirmed'), 'it is confirmed', PATIENCE)
            # Messages may have queued up: with friction not in the model the error is 8 N m.
            rig.until(lambda: happened(models, 'swapped'), 'it runs in the twin', PATIENCE)
            rig.until(lambda: rms(residuals[-1000:]) < 2.0 * NOISE, 'its residual is small',
                      PATIENCE)
            assert not happened(events, 'fault')

            # It was judged by regime, on the edges that its recordings gave.
            assert (champion.folder / 'regimes.json').is_file()
            assert promoted['evidence']['regimes'].keys() == {
                name for name, one in promoted['evidence']['regimes'].items()
                if name.startswith('T_g ') and one['rms_newer'] < one['rms_older']}

            # The bag that it was made from holds the inputs, and the latched topic.
            bag = store.path / champion.record['bag']['path']
            recording = read_recording([bag], load_signals(
                'load_simulator', [s.name for s in PLANT.signals]), ['u_m'], STEP)
            assert sum(map(len, recording.series)) > 2000
            assert 'model_info' in (bag / 'metadata.yaml').read_text()

            back = rig.service(f'{KEEP}/rollback')
            assert (back.success, back.message) == (True, 'version 0001 is the champion again')
            rig.until(lambda: parameter(rig, 'model').endswith('0001/model.yaml'),
                      'the twin runs the first model again', PATIENCE)
            assert not rig.service(f'{KEEP}/promote').success      # no challenger is left
            asked = rig.service(f'{KEEP}/capture')
            assert asked.message == 'captures, 4 s to come'
            events.clear()
            reason.publish(String(data='the oil\n was changed'))
            captured = rig.until(lambda: happened(events, 'captured'), 'it is captured', PATIENCE)
            assert captured['why'][-1] == 'asked for: the oil was changed'
            assert 'the oil was changed' in (Path(captured['bag']) / 'metadata.yaml').read_text()
        # By the verb, while keep is away; it reads the store when it starts.
        store.promote('0002', 'a person')
        with process(*keep, '-p', 'policy:=ask'):
            rig.until(lambda: parameter(rig, 'model').endswith('0002/model.yaml'),
                      'the champion runs again', PATIENCE)


def test_what_no_start_can_be_made_of_is_one_line(tmp_path: Path) -> None:
    for arguments, says in (([], "set the parameter 'store'"),
                            (['-p', f'store:={tmp_path}', '-p', 'policy:=sometimes'],
                             'observe and ask and auto'),
                            (['-p', f'store:={tmp_path}', '-p', 'alpha:=2.0'], '')):
        done = subprocess.run([sys.executable, '-m', 'hydro_twin.commands.main', 'keep',
                               '--ros-args', *arguments], capture_output=True, text=True,
                              check=False)
        assert done.returncode == 2, done.stderr
        assert done.stderr.startswith('hydro-twin keep: ')
        assert says in done.stderr
        assert done.stderr.count('\n') == 1
