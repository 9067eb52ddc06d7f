"""The launch files against the node: only executables and parameters that are there."""
from __future__ import annotations

import argparse
import atexit
from collections.abc import Callable
import importlib.util
import json
from pathlib import Path
import runpy
import sys
import tempfile
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml

from hydro_twin.commands.registry import verbs
from hydro_twin.commands.verb import Verb
from hydro_twin.keep.settings import SETTINGS as KEEP
from hydro_twin.live.settings import SETTINGS
from hydro_twin.model import read_model
from hydro_twin.plants import PLANTS
from hydro_twin.share import share_folder

ROOT = share_folder()
TOPICS = {'/load_simulator/command', '/load_simulator/joint_states', '/diagnostics',
          *(f'/hydro_twin/{model}{topic}' for model in ('', 'before/')
            for topic in ('prediction', 'residual'))}


class Noted:
    """Stands in for anything of launch: notes what it was called with."""

    def __init__(self, *args: Any, **words: Any) -> None:
        self.args = args
        self.words = words

    def perform(self, context: dict[str, str]) -> str:
        return context[self.args[0]]


class Noting(ModuleType):
    """A module of which everything is a class of its own that notes."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__'):
            raise AttributeError(name)
        made = type(name, (Noted,), {})
        setattr(self, name, made)
        return made


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], dict[str, Any]]:
    """Run a launch file, without launch."""
    for name in ('launch', 'launch.actions', 'launch.event_handlers', 'launch.substitutions',
                 'launch.launch_description_sources', 'launch_ros', 'launch_ros.actions',
                 'launch_ros.parameter_descriptions', 'launch_ros.substitutions'):
        monkeypatch.setitem(sys.modules, name, Noting(name))
    return lambda name: runpy.run_path(str(ROOT / 'launch' / f'{name}_launch.py'))


def arguments(launched: Callable[[str], dict[str, Any]]) -> dict[str, dict[str, Any]]:
    made = launched('twin')['generate_launch_description']()
    return {action.args[0]: action.words for action in made.args[0]
            if type(action).__name__ == 'DeclareLaunchArgument'}


def node(launched: Callable[[str], dict[str, Any]], **given: str) -> Any:
    context = {name: words.get('default_value', '')
               for name, words in arguments(launched).items()} | given
    made, = launched('twin')['twin'](context)
    assert type(made).__name__ == 'LifecycleNode'
    return made


def test_every_plant_is_a_choice_and_what_a_system_sets_is_an_argument(launched: Any) -> None:
    given = arguments(launched)
    assert given['plant']['choices'] == ['', *PLANTS]
    assert {'model', 'models', 'config', 'mode', 'wait', 'use_sim_time', 'autostart', 'namespace',
            'name', 'log_level'} <= set(given)
    for setting in SETTINGS:
        if setting.default and setting.name in given and setting.default != ('',):
            assert str(setting.default).lower() in given[setting.name]['description']
    assert 'default_value' not in given['model']


def test_the_launch_file_sets_parameters_that_the_node_declares(launched: Any) -> None:
    made = node(launched, model='model.yaml')
    assert (made.words['package'], made.words['executable']) == ('hydro_twin', 'node')
    values, = made.words['parameters']
    assert set(values) == {'model'}     # all else is left to the defaults of the node
    assert {word: made.words[word].args for word in ('name', 'namespace')} == {
        'name': ('name',), 'namespace': ('namespace',)}
    level, value = made.words['ros_arguments']
    assert (level, value.args) == ('--log-level', ('log_level',))
    everything = {s.name: 'given' for s in SETTINGS if s.name != 'sample_time'}
    values, = node(launched, **everything, use_sim_time='true').words['parameters']
    assert set(values) == {*everything, 'use_sim_time'}


def test_what_is_not_given_to_launch_is_left_to_the_parameter_file(launched: Any) -> None:
    config, values = node(launched, config='my_rig.yaml', plant='cylinder').words['parameters']
    assert config == 'my_rig.yaml'
    assert set(values) == {'plant'}


def test_keep_is_launched_beside_the_node_with_parameters_that_it_declares(launched: Any) -> None:
    context = {name: words.get('default_value', '')
               for name, words in arguments(launched).items()} | {
                   'keep': 'store', 'policy': 'auto'}
    node_, made = launched('twin')['twin'](context)
    assert type(node_).__name__ == 'LifecycleNode'
    assert (made.words['package'], made.words['executable']) == ('hydro_twin', 'keep')
    values, = made.words['parameters']
    assert set(values) <= {s.name for s in KEEP} | {'use_sim_time'}
    assert {name: value.args[0].args for name, value in values.items()} == {
        'store': ('keep',), 'twin': ('name',), 'policy': ('policy',)}
    policy = arguments(launched)['policy']
    assert policy['default_value'] == ''
    assert 'observe' in policy['description']


def test_the_demonstration_makes_a_folder_when_it_runs_and_takes_it_away(
        launched: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    at_end: list[Any] = []
    monkeypatch.setattr(atexit, 'register', lambda *call, **words: at_end.append((call, words)))
    demo = launched('demo')
    described, = demo['generate_launch_description']().args[0]
    assert not list(tmp_path.iterdir())
    described.words['function'](None)
    assert len(list(tmp_path.iterdir())) == 1
    for (function, *args), words in at_end:
        function(*args, **words)
    assert not list(tmp_path.iterdir())


def test_the_demonstration_traces_and_plays_a_bag_that_is_there(
        launched: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    trace, handler = launched('demo')['demonstration'](None)
    twin, play = handler.args[0].words['on_exit'](SimpleNamespace(returncode=0), None)
    assert handler.args[0].words['on_exit'](SimpleNamespace(returncode=2), None) == []
    assert set(dict(twin.words['launch_arguments'])) <= set(arguments(launched))
    for verb, action in (('trace', trace), ('replay', play)):
        _, *path = action.words['cmd'][4].args[0]
        assert (ROOT.joinpath(*path) / 'metadata.yaml').is_file()
        assert action.words['cmd'][:4] == ['ros2', 'run', 'hydro_twin', verb]
        parser = argparse.ArgumentParser(exit_on_error=False)
        command = verbs()[verb]
        assert isinstance(command, Verb)
        command.add_arguments(parser)
        parser.parse_args(['bag', *action.words['cmd'][5:]])


def test_the_loop_is_launched_with_a_rig_that_wears_and_keep_beside_the_twin(
        launched: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip('rclpy')
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    rig, twin = launched('loop')['loop']({'store': ''})
    module, *words = rig.words['cmd'][2:]
    assert importlib.util.find_spec(module)
    assert words == ['--at', '120', '360']
    given = dict(twin.words['launch_arguments'])
    assert set(given) <= set(arguments(launched))
    assert read_model(Path(given['model'])).plant.name == 'load_simulator'
    assert Path(given['keep']).parent == Path(given['model']).parent
    (values,) = yaml.safe_load(Path(given['config']).read_text())['/hydro_twin_keep'].values()
    by_name = {setting.name: setting for setting in KEEP}
    assert not any(by_name[name].objection(value) for name, value in values.items())


@pytest.mark.parametrize('path', sorted((ROOT / 'config').glob('foxglove_*.json')))
def test_foxglove_layouts_show_panels_they_define(path: Path) -> None:
    layout = json.loads(path.read_text('utf-8'))

    def panels(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else panels(node['first']) | panels(node['second'])

    assert panels(layout['layout']) == set(layout['configById'])
    shown = {p['value'].partition('.')[0] for panel in layout['configById'].values()
             for p in panel.get('paths', [])}
    assert shown <= TOPICS


@pytest.mark.parametrize('path', sorted((ROOT / 'config').glob('plotjuggler_*.xml')))
def test_plotjuggler_layouts_show_topics_they_subscribe(path: Path) -> None:
    root = ET.parse(path).getroot()
    topics = {topic.attrib['name'] for topic in root.iter('topic')}
    assert topics <= TOPICS
    for curve in root.iter('curve'):
        assert any(curve.attrib['name'].startswith(f'{topic}/') for topic in topics)
