"""d_1 and the flow from a curve, and curves that are refused."""
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.errors import DataError
from hydro_twin.studies.l18.flow_characteristic import read_characteristic

GOOD = 'opening,flow\n0,0\n0.2,0.35\n0.5,0.72\n0.8,0.93\n1,1\n1.05,1.01\n'


def write(folder: Path, text: str) -> Path:
    path = folder / 'curve.csv'
    path.write_text(text)
    return path


def test_reads_d_1_and_the_flow(tmp_path: Path) -> None:
    curve = read_characteristic(write(tmp_path, GOOD))
    assert curve.d_1 == 1.05
    assert curve([0.2, 1.0, 1.05]) == pytest.approx([0.35, 1.0, 1.01])
    assert np.all(np.diff(curve(np.linspace(0, 1.2, 500))) > 0)


def test_per_cent_is_read_as_said(tmp_path: Path) -> None:
    curve = read_characteristic(write(
        tmp_path, 'opening [%],flow [%]\n0,0\n50,72\n100,100\n105,105\n'))
    assert curve.d_1 == pytest.approx(1.05)
    assert float(curve(0.5)) == pytest.approx(0.72)


@pytest.mark.parametrize(('text', 'says'), [
    (GOOD.replace('0.93', '0.70'), 'flow does not rise from row 3 to 4'),
    (GOOD.replace('0.8,', '0.4,'), 'opening does not rise'),
    (GOOD.replace('opening,flow', 'flow,opening'), 'swapped'),
    ('opening,flow\n0,0\n0.35,0.2\n0.72,0.5\n0.93,0.8\n1,1\n1.01,1.05\n', 'swapped'),
    ('opening,flow\n0,0\n0.5,0.6\n0.95,0.97\n', 'opening ends at 0.95, below 1'),
    ('opening,flow\n0,0\n0.5,0.6\n1.05,0.97\n', 'flow ends at 0.97, below 1'),
    ('opening,flow\n0,0\n50,72\n105,105\n', 'mark per cent'),
    ('opening,flow\n0,0\n1.05,1\n', 'at least 3'),
    ('opening,flow\n0,0\n0.5,much\n1.05,1\n', 'not a table of numbers'),
    ('opening,flow\n0,0\n0.5,nan\n1.05,1\n', 'not finite'),
    ('lift,steam\n0,0\n0.5,0.6\n1.05,1\n', 'has the columns lift, steam'),
    ('', 'not a table of numbers'),
])
def test_bad_curves_are_refused_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(DataError, match=says) as caught:
        read_characteristic(path)
    assert str(path) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match='no such file'):
        read_characteristic(tmp_path / 'none.csv')
