"""The comparison's page, table and object, from made-up runs."""
from __future__ import annotations

import csv
from html.parser import HTMLParser
import json
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from hydro_twin.errors import UserError
from hydro_twin.predictors.predictor import MODES
from hydro_twin.studies.b19 import comparison
from hydro_twin.studies.b19.comparison import page, summary, table, write_comparison
from hydro_twin.studies.b19.study import PARTS, Run, Study, TITLES

RUNS = 6


@pytest.fixture(scope='module')
def result() -> dict[str, object]:
    rng = np.random.default_rng(0)
    runs = {method: [Run({(part, mode): float(rng.uniform(1, 2)) + i for part in PARTS
                          for mode in MODES}, np.linspace(9, 1, 30) + rng.uniform(),
                         np.linspace(8, 2, 30) + k if method in ('mlp', 'hybrid') else None)
                     for k in range(RUNS)] for i, method in enumerate(TITLES)}
    runs['mlp'][2].errors['test', 'free_run'] = np.inf      # type: ignore[index]
    both = dict.fromkeys(PARTS, 8.0)
    study = Study(runs, {'train': 995, 'test': 495}, both, both)
    return {'plant': 'load_simulator', 'unit': 'N m', 'bags': ['one & <two>'], 'runs': RUNS,
            'settings': {name: {'mlp': {'hidden': [7, 5], 'decay': 5e-6},
                                'hybrid': {'hidden': [9], 'decay': 0.0}}
                         for name in ('direct', 'swapped')},
            'experiments': summary({'direct': study, 'swapped': study})}


@pytest.fixture(scope='module')
def text(result: dict[str, object]) -> str:
    return page(result)


class Tags(HTMLParser):
    """Collects what the page refers to, and checks that tables close."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[str] = []
        self.open = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.references += [value or '' for name, value in attrs
                            if name in ('src', 'href', 'xlink:href')]
        self.open += tag in ('table', 'tr', 'svg')

    def handle_endtag(self, tag: str) -> None:
        self.open -= tag in ('table', 'tr', 'svg')


def test_the_page_needs_no_other_file(text: str) -> None:
    tags = Tags()
    tags.feed(text)
    assert tags.open == 0
    elsewhere = [there for there in tags.references if not there.startswith('#')]
    assert elsewhere == ['data:,']      # the icon, in the page itself
    assert 'one &amp; &lt;two&gt;' in text
    for title in TITLES.values():
        assert f'<td>{title}</td>' in text
    assert f'MLP 1 of {RUNS}' in text
    assert 'MLP: 7, 5, weight decay 5e-06' in text
    assert text.count('<svg') == 4
    for piece in text.split('<svg')[1:]:
        ET.fromstring('<svg' + piece[:piece.index('</svg>')] + '</svg>')


def test_the_table_has_every_single_error(result: dict[str, object]) -> None:
    rows = list(csv.DictReader(table(result['experiments']).splitlines()))
    assert len(rows) == 2 * len(TITLES) * RUNS * len(PARTS) * len(MODES)
    methods = result['experiments']['direct']['methods']    # type: ignore[index]
    for row in rows[:200]:
        error = methods[row['method']]['runs'][row['part']][row['mode']][int(row['run'])]
        assert row['rms'] == ('diverged' if error is None else repr(error))
    assert sum(row['rms'] == 'diverged' for row in rows) == 2


def test_the_object_is_strict_json(result: dict[str, object]) -> None:
    methods = json.loads(json.dumps(result, allow_nan=False))['experiments']['direct']['methods']
    assert methods['mlp']['diverged'] == 1
    assert methods['mlp']['five_numbers']['test']['free_run'][-1] is None
    assert methods['ea']['five_numbers']['test']['one_step'] == pytest.approx(
        np.percentile(methods['ea']['runs']['test']['one_step'], [0, 25, 50, 75, 100]))


def test_writes_the_three_files(result: dict[str, object], text: str, tmp_path: Path,
                                monkeypatch: pytest.MonkeyPatch) -> None:
    # Drawn already.
    monkeypatch.setattr(comparison, 'page', lambda what: text if what is result else page(what))
    files = write_comparison(result, tmp_path / 'new' / 'folder')
    assert sorted(file.name for file in (tmp_path / 'new' / 'folder').iterdir()) == sorted(
        file.name for file in files) == ['comparison.csv', 'comparison.html', 'comparison.json']
    assert files[0].read_text(encoding='utf-8') == text


def test_writes_all_or_none(result: dict[str, object], text: str, tmp_path: Path,
                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, 'page', lambda what: text if what is result else page(what))
    write_text = Path.write_text

    def full(path: Path, text: str, **more: str) -> int:
        if path.suffix == '.json':
            raise OSError(28, 'No space left on device')
        return write_text(path, text, **more)

    monkeypatch.setattr(Path, 'write_text', full)
    with pytest.raises(UserError, match='No space left'):
        write_comparison(result, tmp_path)
    assert list(tmp_path.iterdir()) == []
