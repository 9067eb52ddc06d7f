"""Measured data of others, where HYDRO_TWIN_DATA has it: the commands and figures of the docs."""
from __future__ import annotations

import json
import os
from pathlib import Path
import re
from typing import Any

import numpy as np
import pytest

from hydro_twin.commands.main import main
from hydro_twin.model import load_predictor
from hydro_twin.plants import PLANTS
from hydro_twin.recording.rig import read, rig_of
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording

ROOT = Path(__file__).parents[1]
DOCS = ROOT / 'docs'
PAGE = (DOCS / 'measured.md').read_text()
DATA = Path(os.environ.get('HYDRO_TWIN_DATA', 'nowhere'))

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:module 'sre_"),   # of what rclpy imports
    pytest.mark.skipif(not (DATA / 'positioning').is_dir(), reason='HYDRO_TWIN_DATA is not set'),
]


class Shell:
    """Runs verbs and returns what they print."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def __call__(self, *arguments: object) -> Any:
        assert main([*map(str, arguments), '--json']) == 0
        return json.loads(self.capsys.readouterr().out)


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


FITTED = 0.03      # by which figures of a fit may differ between processors


def documented(label: str, *values: float, rel: float = 0.0) -> None:
    """Fail unless the last figures of a table row with this label are these, as rounded there."""
    rows = [re.findall(r'\d+\.?\d*', row.partition('|')[2])[-len(values):]
            for row in re.findall(rf'^\| [^|]*{label}[^|]*(\|.*)', PAGE, re.MULTILINE)]
    assert any(len(row) == len(values) and all(
        value == pytest.approx(float(cell), rel=rel,
                               abs=0.501 * 10.0 ** -len(cell.partition('.')[2]))
        for cell, value in zip(row, values, strict=True)) for row in rows), (label, values, rows)


def emps(shell: Shell, folder: Path) -> tuple[Path, Path]:
    bags = []
    for name in ('DATA_EMPS', 'DATA_EMPS_PULSES'):
        bags.append(folder / name)
        shell('import', DATA / 'positioning' / f'{name}.mat', '-o', bags[-1],
              '--map', ROOT / 'config' / 'measured' / 'positioning.yaml')
    return bags[0], bags[1]


def test_positioning(shell: Shell, tmp_path: Path) -> None:
    train, test = emps(shell, tmp_path)
    for criterion in ('one_step', 'free_run'):
        model = tmp_path / f'{criterion}.yaml'
        fit = shell('refit', train, '--test', test, '--plant', 'positioning', '--criterion',
                    criterion, '-o', model)
        found = shell('replay', test, '--model', model)
        assert found['one_step']['rmse'] == pytest.approx(fit['test']['one_step'], rel=1e-3)
        assert fit['at_bound'] == []
        documented(f'fitted to {"one step" if criterion == "one_step" else "the free run"}',
                   fit['parameters']['M']['value'], fit['parameters']['F_v']['value'],
                   1e3 * found['one_step']['rmse'], 1e3 * found['free_run']['rmse'], rel=FITTED)
    published = shell('replay', test, '--model', DOCS / 'measured' / 'positioning_published.yaml')
    documented('published values', 1e3 * published['one_step']['rmse'],
               1e3 * published['free_run']['rmse'])
    documented('persistence', 1e3 * published['persistence']['rmse'])
    # What is missing shows: with it, the same plant is an order of magnitude better.
    assert published['free_run']['rmse'] < 0.1 * found['free_run']['rmse']


@pytest.mark.measured
def test_what_the_axis_lacks(shell: Shell, tmp_path: Path) -> None:
    train, test = emps(shell, tmp_path)
    found = shell('trace', train, '--test', test, '--plant', 'positioning', '-o', tmp_path / 'out')
    effects = {effect['id']: effect['parameters'] for effect in found['effects']}
    assert set(effects) == {'friction', 'bias'}
    # The last digits of a rough fit are the processor's, and with them the path of the search: the
    # published values are near on all, and most of the error is gone.
    for name, parameter, published in (('friction', 'coulomb', 20.39), ('bias', 'offset', 3.2)):
        assert effects[name][parameter]['value'] == pytest.approx(published, rel=0.25)
    before, after = (1e3 * found[when]['free_run']['test'] for when in ('before', 'after'))
    assert after < 0.1 * before
    linear, = re.findall(r'\| linear \| \| \| \S+ \| (\S+) \|', PAGE)
    assert before == pytest.approx(float(linear), rel=0.05)


def test_cylinder(shell: Shell, tmp_path: Path) -> None:
    bags = []
    for table in sorted((DATA / 'eha').glob('*.csv.gz')):
        bags.append(tmp_path / table.name.removesuffix('.csv.gz'))
        shell('import', table, '-o', bags[-1], '--map', ROOT / 'config' / 'measured' / 'eha.yaml')
    assert len(bags) == 20

    def whole(model: Path) -> float:
        errors = [shell('replay', bag, '--model', model)['free_run']['rmse'] for bag in bags]
        return float(np.sqrt(np.mean(np.square(errors))))

    for criterion in ('one_step', 'free_run'):
        model = tmp_path / f'{criterion}.yaml'
        fit = shell('refit', *bags, '--plant', 'cylinder', '--criterion', criterion, '-o', model)
        documented(f'fitted to {"one step" if criterion == "one_step" else "the free run"}',
                   1e6 * fit['parameters']['K_v']['value'], 1e3 * fit['test']['one_step'],
                   1e3 * whole(model), rel=FITTED)
    documented('persistence', 1e3 * fit['persistence']['test'])
    documented('published speeds', 1e3 * whole(DOCS / 'measured' / 'cylinder_asymmetry.yaml'))


@pytest.mark.measured
def test_servo_valve_and_cylinder(shell: Shell, tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    shell('import', *sorted((DATA / 'servo_valve_cylinder').glob('*.csv.gz')), '-o', bag,
          '--map', ROOT / 'config' / 'measured' / 'servo_valve_cylinder.yaml')
    fit = shell('refit', bag, '--plant', 'cylinder', '-o', tmp_path / 'model.yaml')
    assert any('end of its travel' in note for note in fit['notes'])
    # By the slopes of the strokes: 0.05 m/s a volt out, 0.035 back. Standing, it would be near 0.
    assert 0.025 < fit['parameters']['K_v']['value'] < 0.055
    found = shell('trace', bag, '--plant', 'cylinder', '-o', tmp_path / 'out')
    effects = {effect['id']: effect['parameters'] for effect in found['effects']}
    # The command only steps: a dead zone and a hysteresis of it hardly differ.
    assert set(effects) in ({'end_stop', 'asymmetry', 'dead_zone'},
                            {'end_stop', 'asymmetry', 'hysteresis'})
    assert effects['end_stop']['upper']['value'] == pytest.approx(0.2, rel=0.02)
    assert effects['asymmetry']['imbalance']['value'] == pytest.approx(0.17, abs=0.03)
    assert found['after']['free_run']['test'] < 0.00256     # m, that of the fit by hand


@pytest.mark.measured
@pytest.mark.parametrize('joint', ['boom', 'stick', 'bucket'])
def test_excavator(joint: str, shell: Shell, tmp_path: Path) -> None:
    shell('import', *sorted((DATA / 'excavator').glob('*.csv.gz')), '-o', tmp_path / joint,
          '--map', ROOT / 'config' / 'measured' / f'excavator_{joint}.yaml')
    found = shell('trace', tmp_path / joint, '--plant', 'cylinder', '-o', tmp_path / 'out')
    effects = {effect['id']: effect['parameters'] for effect in found['effects']}
    # Beside the dead zone a limit, which nothing that is known of the machine excludes; and, as
    # the page has it, said to be improbable, a lag of the bucket.
    doubtful = {'lag'} if joint == 'bucket' else set()
    assert 'dead_zone' in effects
    assert set(effects) <= {'dead_zone', 'rate_limit', 'saturation'} | doubtful
    assert all(effect['probability'] < 0.5 for effect in found['effects']
               if effect['id'] in doubtful)
    zone = effects['dead_zone']
    edges = [zone.get('centre', {'value': 0.0})['value'] + side * zone['width']['value']
             for side in (-1.0, 1.0)]
    row, = re.findall(rf'^\| {joint} \|(.*)', PAGE, re.MULTILINE)
    says = [float(edge) for edge in re.findall(r'(-?[\d.]+) to (-?[\d.]+)', row)[1]]
    assert edges == pytest.approx(says, abs=0.1)
    assert not any(effect['certain'] for effect in found['effects'])


@pytest.mark.measured
def test_water_valve(shell: Shell, tmp_path: Path) -> None:
    shell('import', DATA / 'water_valve' / 'actuator3_2001-10-11_1h.csv.gz', '-o',
          tmp_path / 'valve', '--map', ROOT / 'config' / 'measured' / 'water_valve.yaml')
    found = shell('trace', tmp_path / 'valve', '--plant', 'control_valve', '-o', tmp_path / 'out')
    first, *others = found['effects']   # no backlash, which gains nothing by hand either
    assert (first['id'], first['port']) == ('rate_limit', 'actuator')
    assert {effect['id'] for effect in others} <= {'mode', 'lag'}
    limits = first['parameters']
    closing = limits['limit']['value'] * (1.0 - limits['imbalance']['value'])
    says, = re.findall(r'closes at no more than (\S+) % of its stroke a second', PAGE)
    assert 100.0 * closing == pytest.approx(float(says), abs=0.1)
    assert not any(effect['certain'] for effect in found['effects'])
    documented('repeating the last sample', 100.0 * found['persistence']['test'])
    documented('linear: a lag', 100.0 * found['before']['free_run']['test'],
               rel=FITTED)
    documented('traced', 100.0 * found['after']['free_run']['test'], rel=FITTED)


@pytest.mark.measured
def test_leg(shell: Shell, tmp_path: Path) -> None:
    maps = ROOT / 'config' / 'measured'
    shell('import', DATA / 'leg' / 'policy1_sin1Hz.csv.gz', '-o', tmp_path / 'leg',
          '--map', maps / 'leg.yaml')
    found = shell('trace', tmp_path / 'leg', '--plant', 'load_simulator', '--config',
                  maps / 'leg_rig.yaml', '-o', tmp_path / 'out')
    # Which curve or law is found hangs on the last digits, so on the processor: none is certain.
    assert not any(effect['certain'] for effect in found['effects'])
    linear, = re.findall(r'of the shape of the load simulator \| (\S+) \|', PAGE)
    before, after = (found[when]['free_run']['test'] for when in ('before', 'after'))
    assert before == pytest.approx(float(linear), rel=0.25)
    # Better than repeating the last sample, as the linear plant is on no processor.
    assert after < found['persistence']['test'] < before


def test_live_on_the_played_recording(shell: Shell, tmp_path: Path, rig: Any) -> None:
    """Two seconds of EMPS, in which it moves, through a node of its own process."""
    from ros_rig import lossless, play, twin
    from sensor_msgs.msg import JointState

    plant = PLANTS['positioning']
    train, test = emps(shell, tmp_path)
    model = tmp_path / 'model.yaml'
    shell('refit', train, '--plant', 'positioning', '--criterion', 'one_step', '-o', model)
    bag = tmp_path / 'bag'
    signals = load_signals('positioning', [signal.name for signal in plant.signals])
    write_recording(bag, [read([test], rig_of(plant)).series[0].part(2000, 4000)], signals)
    series = read([bag], rig_of(plant)).series[0]
    assert np.ptp(series['x']) > 0.01
    expected = load_predictor(model).one_step(series)

    topics = sorted({signal.topic for signal in signals.values()})
    heard = rig.listen('/hydro_twin/prediction', JointState)
    with twin(model=model, mode='one_step', **lossless(topics)):
        rig.ready(topics)
        play(bag)
        rig.until(lambda: len(heard) >= len(series) - plant.order, 'all is predicted')
    assert [message.position[0] for message in heard] == expected[plant.order:].tolist()
