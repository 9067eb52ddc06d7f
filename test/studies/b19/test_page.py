"""The page on [B19] says what is stored, and what is stored is what is found."""
from __future__ import annotations

from itertools import pairwise
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from hydro_twin.errors import UserError
from hydro_twin.studies.b19.blocks import PUBLISHED
from hydro_twin.studies.b19.layout import median, number, p_value
from hydro_twin.studies.b19.outlook import RIG
from hydro_twin.studies.b19.page import BLOCK, blocks, boxes, filled, learning

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / 'docs' / 'load_simulator.md').read_text(encoding='utf-8')


@pytest.fixture(scope='module')
def results() -> dict[str, Any]:
    stored: dict[str, Any] = json.loads(
        (ROOT / 'docs' / 'load_simulator.json').read_text(encoding='utf-8'))
    return stored


def block(name: str) -> str:
    """Take what the page has between the marks of a block."""
    return next(match[0] for match in BLOCK.finditer(PAGE) if match[1] == name)


def rows(name: str) -> list[list[str]]:
    """Take the cells of a table of the page, without its head."""
    lines = [line for line in block(name).splitlines() if line.startswith('|')]
    return [[cell.strip() for cell in line.strip('|').split('|')] for line in lines[2:]]


def test_the_page_says_what_is_stored(results: dict[str, Any]) -> None:
    assert filled(PAGE, blocks(results)) == PAGE


def test_the_figures_are_drawn_from_what_is_stored(results: dict[str, Any]) -> None:
    for name, draw in (('learning', learning), ('boxes', boxes)):
        path = ROOT / 'docs' / 'img' / f'load_simulator_{name}.svg'
        assert f'(img/{path.name})' in PAGE
        assert shapes(path.read_text(encoding='utf-8')) == shapes(draw(results))


def shapes(drawing: str) -> list[tuple[float, float]]:
    """Take the points of all paths, to a pixel: versions of matplotlib differ in the rest."""
    return [(round(float(x)), round(float(y))) for path in re.findall(r' d="([^"]*)"', drawing)
            for x, y in re.findall(r'[ML] ([\d.-]+) ([\d.-]+)', path) if len(path) > 500]


def test_medians_and_p_values_are_those_of_the_stored_runs(results: dict[str, Any]) -> None:
    """Cell by cell, with numpy and scipy."""
    runs = results['published']['runs']
    here = next(row for row in rows('one-step') if row[0] == 'here, test, median')
    order = ('random', 'ea', 'bees', 'pso', 'mlp', 'hybrid', 'least_squares')
    for cell, method in zip(here[1:], order, strict=False):
        assert float(cell) == pytest.approx(
            np.median(runs[method]['test']['one_step']), rel=6e-4)
    table = {row[0]: row[1:] for row in rows('p-test')}
    found = mannwhitneyu(runs['bees']['test']['one_step'], runs['pso']['test']['one_step']).pvalue
    assert float(table['BA'][3].split()[0]) == pytest.approx(found, rel=0.5)
    assert found < 0.05
    assert np.median(runs['pso']['test']['one_step']) < np.median(runs['bees']['test']['one_step'])


def test_the_choice_follows_the_rule(results: dict[str, Any]) -> None:
    """The least mean, or the smallest that it does not beat at 5 %, by scipy."""
    for rounds in results['settings'].values():
        for one in rounds:
            best = min(one['candidates'], key=lambda c: np.mean(c['validation']))
            tied = [c for c in one['candidates'] if c is best or mannwhitneyu(
                c['validation'], best['validation']).pvalue > 0.05]

            def weights(candidate: dict[str, Any]) -> int:
                layers = [14, *candidate['hidden'], 1]
                return sum((a + 1) * b for a, b in pairwise(layers))

            smallest = min(weights(c) for c in tied)
            chosen = next(c for c in one['candidates'] if {
                key: c[key] for key in ('hidden', 'decay')} == one['chosen'])
            assert chosen in tied
            assert weights(chosen) == smallest


def test_published_figures_are_those_of_the_paper() -> None:
    row = next(row for row in rows('one-step') if row[0] == 'published, test, median')
    assert row[1:7] == ['5.573', '5.449', '5.386', '5.448', '1.507', '1.482']
    assert PUBLISHED['train, median'][3] == 9.30119


def test_the_rig_at_higher_frequencies_is_that_of_the_sample() -> None:
    made = ' '.join((ROOT / 'bags' / 'make.sh').read_text().replace('\\\n', ' ').split())
    for option in re.findall(r'--\S+ \S+', RIG):
        assert option in made, option


def test_every_step_is_stored(results: dict[str, Any]) -> None:
    from hydro_twin.studies.b19.reproduce import STEPS
    assert results.keys() == STEPS.keys()
    assert len(results['published']['runs']['mlp']['test']['one_step']) == 20


def test_numbers_are_written_as_in_print() -> None:
    assert [number(x) for x in (6.18324, 19.5811, 337.04, 0.01, np.inf)] == [
        '6.183', '19.58', '337.0', '0.01000', 'diverged']
    assert [p_value(x) for x in (0.4812, 3.1e-5, 6.8e-8)] == ['0.48', '3e-5', '7e-8']
    assert median([1.0, None, 2.0]) == 2.0


def test_a_page_that_lacks_a_block_is_refused() -> None:
    text = 'a\n\n<!-- one -->\nold\n<!-- end -->\n\nb\n'
    assert filled(text, {'one': 'new'}) == text.replace('old', 'new')
    empty = text.replace('old\n', '') + text.replace('one', 'next')
    assert filled(empty, {'one': 'new', 'next': 'x'}).count('new') == 1
    with pytest.raises(UserError, match='it has one'):
        filled(text, {'one': 'new', 'two': 'x'})


@pytest.mark.slow
def test_a_share_run_again_gives_what_is_stored(
    results: dict[str, Any], tmp_path: Path,
) -> None:
    """The linear figures to rounding; networks, which magnify it, about their stored spread."""
    pytest.importorskip('torch')
    from hydro_twin.fitting.network import SETTINGS
    from hydro_twin.studies.b19 import choices
    from hydro_twin.studies.b19.reproduce import Job, rounded, run_step
    from hydro_twin.studies.b19.settings import network_models

    job = Job(tmp_path, runs=2)
    box, stored = run_step('box', job), results['box']
    for kind in ('boxes', 'displacements'):
        for name, found in box[kind].items():
            assert found['at_bound'] == stored[kind][name]['at_bound']
            assert [found['train'], found['test']] == pytest.approx(
                [stored[kind][name]['train'], stored[kind][name]['test']], rel=1e-4)
    for name, errors in run_step('optimisers', job).items():
        assert errors['test'] == pytest.approx(results['optimisers'][name]['test'][:2], rel=1e-3)
    for kind, model in network_models(
            job.recordings['train'], job.rig.plant, job.rig.constants, 0).items():
        errors = choices.one_step_errors(choices.problems_of(model, job.recordings),
                                         SETTINGS[kind], job.seeds, 'cpu')
        for part, found in rounded(errors).items():
            runs = results['published']['runs'][kind][part]['one_step']
            spread = max(runs) - min(runs)
            assert min(runs) - spread < min(found)
            assert max(found) < max(runs) + spread
