"""The launch files against the node: only executables and parameters that are there."""
from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from hydro_twin.share import share_folder

ROOT = share_folder()
NODE = ast.parse((Path(__file__).parents[1] / 'hydro_twin' / 'node.py').read_text('utf-8'))
TOPICS = {'/load_simulator/command', '/load_simulator/joint_states', '/hydro_twin/prediction',
          '/hydro_twin/residual', '/diagnostics'}


def calls(tree: ast.AST, name: str) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)
            and getattr(node.func, 'id', getattr(node.func, 'attr', '')) == name]


def constant(node: Any) -> Any:
    return node.value if isinstance(node, ast.Constant) else None


def test_the_launch_file_sets_parameters_that_the_node_declares() -> None:
    tree = ast.parse((ROOT / 'launch' / 'twin_launch.py').read_text('utf-8'))
    node, = calls(tree, 'Node')
    words = {keyword.arg: constant(keyword.value) for keyword in node.keywords}
    assert (words['package'], words['executable']) == ('hydro_twin', 'node')
    given = {constant(key) for d in ast.walk(node) if isinstance(d, ast.Dict) for key in d.keys}
    declared = {constant(call.args[0]) for call in calls(NODE, 'declare_parameter')}
    assert given - {'use_sim_time'} <= declared
    arguments = {constant(call.args[0]) for call in calls(tree, 'DeclareLaunchArgument')}
    used = {constant(call.args[0]) for call in calls(tree, 'LaunchConfiguration')}
    assert used == arguments == {'model', 'plant', 'config', 'mode', 'use_sim_time'}
    plants = next(ast.literal_eval(k.value) for call in calls(tree, 'DeclareLaunchArgument')
                  for k in call.keywords if k.arg == 'choices')
    assert all((ROOT / 'config' / f'{plant}.yaml').is_file() for plant in plants)


def test_the_demonstration_plays_a_bag_that_is_there() -> None:
    text = (ROOT / 'launch' / 'demo_launch.py').read_text('utf-8')
    compile(text, 'demo_launch.py', 'exec')
    assert "'bags', 'load_simulator_linear'" in text
    assert (ROOT / 'bags' / 'load_simulator_linear' / 'metadata.yaml').is_file()


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
