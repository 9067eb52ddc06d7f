"""The page of the valve servo says what its command prints, and shows the figures it draws."""
from collections.abc import Callable
from pathlib import Path
import re

import pytest

from hydro_twin.studies.l18.reproduce import BLOCK, BLOCKS, main, Results

PAGE = Path(__file__).resolve().parents[3] / 'docs' / 'valve_servo.md'
TEXT = PAGE.read_text(encoding='utf-8')
WRITTEN = {found[2]: found[0].removeprefix(found[1]).removesuffix(found[3])
           for found in BLOCK.finditer(TEXT)}
FAST = ('weights', 'poles')
NUMBER = re.compile(r'-?\d+(?:\.\d+)?(?:e[-+]\d+)?')
# Of noise, to which the last digits of a machine's arithmetic are much: the networks' errors.
LOOSE = {'networks': 0.3, 'residual': 0.3, 'noise': 0.3}


def words_and_numbers(text: str) -> tuple[str, list[float]]:
    return NUMBER.sub('#', text), [float(number) for number in NUMBER.findall(text)]


def assert_page_says(name: str, block: Callable[[Results], str], results: Results) -> None:
    words, numbers = words_and_numbers(WRITTEN[name])
    found_words, found = words_and_numbers(block(results))
    assert found_words == words
    assert found == pytest.approx(numbers, rel=LOOSE.get(name, 0.01), abs=1e-9)


@pytest.fixture(scope='module')
def results() -> Results:
    return Results()


def test_every_block_is_on_the_page() -> None:
    assert sorted(WRITTEN) == sorted(BLOCKS)


@pytest.mark.parametrize('name', FAST)
def test_the_page_says_what_is_computed(name: str, results: Results) -> None:
    assert_page_says(name, BLOCKS[name], results)


@pytest.mark.slow
@pytest.mark.parametrize('name', sorted(set(BLOCKS) - set(FAST)))
def test_the_page_says_what_is_found(name: str, results: Results) -> None:
    assert_page_says(name, BLOCKS[name], results)


def test_the_figures_are_in_the_page_and_small() -> None:
    drawn = {path.name for path in (PAGE.parent / 'img' / 'l18').iterdir()}
    assert drawn == set(re.findall(r'\(img/l18/([^)]+)\)', TEXT))
    assert {f'figure_{number}.png' for number in (4, 5, 6, 8, 9, 10, 11, 12, 13)} <= drawn
    assert all((PAGE.parent / 'img' / 'l18' / name).stat().st_size < 50_000 for name in drawn)


def test_a_page_that_is_not_there_is_refused(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / 'none.md')]) == 2
    error = capsys.readouterr().err
    assert 'none.md' in error
    assert error.count('\n') == 1
    assert list(tmp_path.iterdir()) == []
