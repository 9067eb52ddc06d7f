"""Tests of the picture of a replay."""
import numpy as np
from numpy.testing import assert_array_equal
import pytest

from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series
from hydro_twin.report.picture import draw, SHOWN, write_picture

PLANT = plant_named('positioning')
OUTPUT = PLANT.output


@pytest.fixture(scope='module')
def measured():
    rng = np.random.default_rng(0)
    return [rng.normal(size=size) for size in (2 * SHOWN, 300)]


@pytest.fixture(scope='module')
def figure(measured):
    series = tuple(Series({OUTPUT.name: y}, 0.002) for y in measured)
    return draw(Recording(series), PLANT, {
        'before': [np.zeros_like(y) for y in measured], 'after': [y - 0.25 for y in measured]},
        {'before': 1.5, 'after': 0.25})


def test_curves_are_what_was_measured_predicted_and_missed(figure, measured):
    above, below = figure.axes
    shown = measured[0][:SHOWN]
    for line, expected in zip(above.lines, (shown, 0.0 * shown, shown - 0.25), strict=True):
        assert_array_equal(line.get_ydata(), expected)
    for line, expected in zip(below.lines, (shown, 0.0 * shown + 0.25), strict=True):
        np.testing.assert_allclose(line.get_ydata(), expected, atol=1e-12)
    assert below.lines[0].get_xdata()[-1] == pytest.approx(0.002 * (SHOWN - 1))


def test_legend_has_the_errors(figure):
    texts = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert texts == ['before: 1.5 m RMS', 'after: 0.25 m RMS']


def test_same_figure_same_bytes(figure, tmp_path):
    for name in ('a.png', 'b.png'):
        write_picture(figure, tmp_path / name)
    assert (tmp_path / 'a.png').read_bytes() == (tmp_path / 'b.png').read_bytes()
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')


def test_nothing_is_left_where_it_cannot_be_written(figure, tmp_path):
    (tmp_path / 'taken.png').mkdir()
    with pytest.raises(OSError, match='directory'):
        write_picture(figure, tmp_path / 'taken.png')
    assert [path.name for path in tmp_path.iterdir()] == ['taken.png']
