"""The launch files against the node: only executables and parameters that are there."""
from __future__ import annotations

import argparse
import ast
import importlib
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from hydro_twin.commands.main import VERBS
from hydro_twin.share import share_folder

ROOT = share_folder()
PARAMETERS = ast.parse(
    (Path(__file__).parents[1] / 'hydro_twin' / 'parameters.py').read_text('utf-8'))
TOPICS = {'/load_simulator/command', '/load_simulator/joint_states', '/diagnostics',
          *(f'/hydro_twin/{model}{topic}' for model in ('', 'before/')
            for topic in ('prediction', 'residual'))}


def calls(tree: ast.AST, name: str) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)
            and getattr(node.func, 'id', getattr(node.func, 'attr', '')) == name]


def constant(node: Any) -> Any:
    return node.value if isinstance(node, ast.Constant) else None


def keys(tree: ast.AST) -> set[Any]:
    return {constant(key) for d in ast.walk(tree) if isinstance(d, ast.Dict) for key in d.keys}


def launched(name: str) -> ast.Module:
    return ast.parse((ROOT / 'launch' / f'{name}_launch.py').read_text('utf-8'))


def arguments(tree: ast.AST) -> set[Any]:
    return {constant(call.args[0]) for call in calls(tree, 'DeclareLaunchArgument')}


def test_the_launch_file_sets_parameters_that_the_node_declares() -> None:
    tree = launched('twin')
    node, = calls(tree, 'Node')
    words = {keyword.arg: constant(keyword.value) for keyword in node.keywords}
    assert (words['package'], words['executable']) == ('hydro_twin', 'node')
    declared = {constant(call.args[0]) for call in calls(PARAMETERS, 'declare_parameter')}
    assert keys(tree) - {'use_sim_time'} <= declared
    assert arguments(tree) == keys(tree) | {'plant', 'config'}
    plants = next(ast.literal_eval(k.value) for call in calls(tree, 'DeclareLaunchArgument')
                  for k in call.keywords if k.arg == 'choices')
    assert all((ROOT / 'config' / f'{plant}.yaml').is_file() for plant in plants)


def test_the_demonstration_traces_and_plays_a_bag_that_is_there() -> None:
    tree = launched('demo')
    joined = ast.unparse(calls(tree, 'PathJoinSubstitution')[0].args[0])
    _, *path = ast.literal_eval(joined.replace('share', "'share'"))
    assert (ROOT.joinpath(*path) / 'metadata.yaml').is_file()
    assert keys(tree) <= arguments(launched('twin'))
    run = [[constant(word) for word in call.keywords[0].value.elts[1:]]
           for call in calls(tree, 'ExecuteProcess')]
    for verb, _, *words in run:
        parser = argparse.ArgumentParser(exit_on_error=False)
        importlib.import_module(f'hydro_twin.commands.{VERBS[verb][0]}').add_arguments(parser)
        parser.parse_args(['bag', *(word or 'out' for word in words)])
    assert [verb for verb, *_ in run] == ['trace', 'replay']


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
