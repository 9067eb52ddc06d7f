"""The commands and links of the documentation: each is one that works."""
import argparse
import contextlib
import json
import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from hydro_twin.commands.main import main
from hydro_twin.commands.registry import verbs
from hydro_twin.commands.verb import Verb

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(path for folder in ('.', 'docs', 'bags', 'benchmarks/tracing')
               for path in (ROOT / folder).glob('*.md'))
README = (ROOT / 'README.md').read_text('utf-8')


def commands(text: str) -> list[str]:
    """List the lines of indented code that call the tool, or copy a file for it."""
    return re.findall(r'^    ((?:hydro-twin|cp) .*)$', text, re.MULTILINE)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_parse(page: Path) -> None:
    text = re.sub(r'\$\([^)]*\)', '$NAME', page.read_text('utf-8'))
    for line in re.findall(r'^    .*?\bhydro-twin ([^;|&\n]+)', text, re.MULTILINE):
        verb, *words = shlex.split(line, comments=True)
        assert verb in {*verbs(), 'VERB'}
        if verb not in {'node', 'keep', 'VERB'}:
            parser = argparse.ArgumentParser(exit_on_error=False)
            command = verbs()[verb]
            assert isinstance(command, Verb)
            command.add_arguments(parser)
            parser.parse_args(words)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r'\]\(([^)#\s]+)', page.read_text('utf-8')):
        if not target.startswith('http'):
            assert (page.parent / target).exists(), target


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make what the README starts from: this repository's files, and a table of one's own."""
    folder = tmp_path_factory.mktemp('readme')
    for name in ('bags', 'config'):
        (folder / name).symlink_to(ROOT / name)
    block = re.search(r'```yaml\n(# map\.yaml\n.*?)```', README, re.DOTALL)
    assert block
    (folder / 'map.yaml').write_text(block[1])
    t = np.arange(500) / 100
    np.savetxt(folder / 'run.csv', np.column_stack([t, 900 * np.sin(t), 80 - 70 * np.cos(t)]),
               delimiter=',', header='t,pump_rpm,position_mm', comments='')
    return folder


@pytest.fixture(scope='module')
def environment() -> dict[str, str]:
    return os.environ | {'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'}


OFFLINE = [command for command in commands(README)
           if not re.match('hydro-twin (node|keep)|.*--publish', command)]


@pytest.fixture(scope='module')
def ran(folder: Path) -> Path:
    """Run the README's commands in their order; returns the folder in which they ran.

    The tool's in this process, which has imported what they need.
    """
    with contextlib.chdir(folder):
        for command in OFFLINE:
            program, *words = shlex.split(command)
            if program == 'hydro-twin':
                assert main(words) == 0, command
            else:
                subprocess.run([program, *words], check=True)
    return folder


@pytest.mark.slow
def test_commands_run_in_their_order(ran: Path) -> None:
    assert {shlex.split(command)[1] for command in OFFLINE} >= {*verbs()} - {'node', 'keep'}
    for made in ('run', 'model.yaml', 'traced/report.html', 'predicted', 'replay.png', 'practice',
                 'compared/comparison.html'):
        assert (ran / made).exists()


@pytest.mark.slow
def test_the_figures_of_the_example_are_those_found(ran: Path) -> None:
    """That of docs/tracing.md, whose command is the README's without its configuration."""
    text = (ROOT / 'docs' / 'tracing.md').read_text('utf-8')
    (example,), (own,) = (
        [line for line in commands(page) if line.startswith('hydro-twin trace')]
        for page in (text, README))
    assert own == example.replace(' -o out', ' --config my_rig.yaml -o traced')
    report = json.loads((ran / 'traced' / 'report.json').read_text('utf-8'))
    assert f'> {report["says"]}' in text

    def row(start: str) -> list[float]:
        line = next(line for line in text.splitlines() if line.startswith(f'| {start} '))
        found = [re.match(r'[\d.]+', cell.strip()) for cell in line.split('|')[2:]]
        return [float(number[0]) for number in found if number]

    for kind in ('free_run', 'one_step'):
        for part in ('test', 'train'):
            if found := [s for s in text.splitlines()
                         if s.startswith(f'| {kind.replace("_", " ")}, {part} ')]:
                assert row(found[0][2:].split(' [')[0]) == pytest.approx(
                    [report[when][kind][part] for when in ('before', 'after')], rel=0.02)
    assert row('noise, estimated') == pytest.approx([report['noise_floor']], rel=0.02)
    coulomb = report['effects'][0]['parameters']['coulomb']['value']
    assert row('Coulomb friction')[0] == pytest.approx(coulomb, rel=0.01)
    for name, tolerance in (('J', 0.1), ('B_m', 0.05), ('G', 0.02)):
        values = [report['parameters'][when][name]['value'] for when in ('before', 'after')]
        assert row(name)[:2] == pytest.approx(values, rel=tolerance)
    rival = report['effects'][0]['rivals'][0]
    name = rival['id'].replace('_', ' ')
    distance = re.search(rf'next best explanation, an? {name}, is larger by (\d+)', text)
    assert distance
    assert float(distance[1]) == pytest.approx(rival['delta_bic'], rel=0.02)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:module 'sre_")
def test_the_repaired_model_runs_live_with_a_smaller_residual(
        ran: Path, environment: dict[str, str], rig: Any) -> None:
    """What `before` misses by 4 N m, the repaired one has to within the noise of 0.6."""
    from ros_rig import ended
    from sensor_msgs.msg import JointState

    node, play = (next(command for command in commands(README) if word in command)
                  for word in ('hydro-twin node', '--publish'))
    heard = [rig.listen(f'/hydro_twin/{topic}', JointState)
             for topic in ('residual', 'before/residual')]
    ros = {key: os.environ[key] for key in ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_DOMAIN_ID')}
    with subprocess.Popen(f'exec {node}', shell=True, cwd=ran,
                          env=environment | ros) as twin, ended(twin):
        rig.ready()
        subprocess.run(play, shell=True, cwd=ran, env=environment | ros, check=True)
        rig.until(lambda: min(map(len, heard)) > 3000, 'both models predict')
    after, before = (np.sqrt(np.mean(np.square([m.effort[0] for m in messages])))
                     for messages in heard)
    assert after < 0.25 * before
