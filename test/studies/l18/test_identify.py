"""Both identifications side by side, from the shell."""
import json
from pathlib import Path

import pytest

from hydro_twin.commands.main import main
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording
from hydro_twin.studies.l18.commands.identify import K_1
from hydro_twin.studies.l18.demonstration import simulated_steps, STEPS
from hydro_twin.studies.l18.flow_characteristic import default_characteristic
from hydro_twin.studies.l18.linear_loop import PUBLISHED


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('bags') / 'steps'
    write_recording(path, [simulated_steps(STEPS, default_characteristic())],
                    load_signals('valve_servo', ('command', 'opening')))
    return path


def test_prints_what_it_writes(bag: Path, tmp_path: Path,
                               capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['identify', str(bag), '-o', str(tmp_path), '--json']) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / 'identification.json').read_text())
    free_run = printed['least_squares']['free_run']
    assert free_run['T_y']['value'] == pytest.approx(PUBLISHED.T_y, rel=1e-3)
    assert printed['network']['exact']['parameters']['T_y'] == pytest.approx(PUBLISHED.T_y,
                                                                             rel=0.01)
    assert printed['network']['printed']['parameters'] is None
    tau = printed['network']['nearest']['parameters']['tau']
    assert tau == pytest.approx(PUBLISHED.tau, rel=0.01)
    assert printed['k_1'] == PUBLISHED.k_1 == K_1
    assert sorted(path.stem for path in tmp_path.glob('*.png')) == [
        'figure_10', 'figure_11', 'figure_8', 'figure_9']


def test_shows_a_person_the_paper_beside(bag: Path, tmp_path: Path,
                                         capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['identify', str(bag), '-o', str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert '0.02030' in shown
    assert 'no real positive' in shown


@pytest.mark.parametrize(('arguments', 'says'), [
    (['--k-1', '-1'], 'must be above zero'),
    (['--config', 'none.yaml'], 'none.yaml'),
])
def test_bad_arguments_are_refused_in_one_line(
        bag: Path, tmp_path: Path, arguments: list[str], says: str,
        capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['identify', str(bag), '-o', str(tmp_path / 'out'), *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1
    assert not (tmp_path / 'out').exists()
