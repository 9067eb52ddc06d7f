"""The structure search: its choice, and that it goes on where it was interrupted."""
from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.errors import UserError
from hydro_twin.fitting.network import Problem, Settings
from hydro_twin.fitting.structure_search import choose, split, structure_search

pytest.importorskip('torch')

STRUCTURES = ((1,), (8,))
SETTINGS = Settings(epochs=60, decay=0.0)


@pytest.fixture(autouse=True)
def one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('os.sched_getaffinity', lambda _: {0})


@pytest.fixture
def problem() -> Problem:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (150, 3))
    return Problem(x, np.sin(4 * x[:, 0]) * x[:, 1], np.zeros(3), np.ones(3), 1.0, 100.0)


def search(problem: Problem, log: Path) -> dict[tuple[int, ...], list[float]]:
    return structure_search(problem, SETTINGS, log, structures=STRUCTURES, repeats=4)


def test_goes_on_where_it_stopped(problem: Problem, tmp_path: Path) -> None:
    log = tmp_path / 'search.jsonl'
    scores = search(problem, log)
    lines = log.read_text().splitlines()
    assert len(lines) == 9
    kept = [json.loads(line) for line in lines[1:4]]
    kept[0]['validation'] = 123.0               # shows that it is read, not trained again
    log.write_text('\n'.join([lines[0], *map(json.dumps, kept), lines[4][:20]]))
    resumed = search(problem, log)
    assert resumed[1,][0] == 123.0
    assert (resumed[1,][1:], resumed[8,]) == (scores[1,][1:], scores[8,])
    assert len(log.read_text().splitlines()) == 9


def test_validates_on_patterns_not_trained_on(problem: Problem, tmp_path: Path) -> None:
    log = tmp_path / 'search.jsonl'
    scores = search(problem, log)
    assert choose(scores, 3) == (8,)
    train, rest = split(150, 0, 1)
    assert sorted([*train, *rest]) == list(range(150))
    assert len(train) == 100
    assert not np.array_equal(train, split(150, 0, 2)[0])


def test_refuses_the_file_of_another_search(problem: Problem, tmp_path: Path) -> None:
    log = tmp_path / 'search.jsonl'
    search(problem, log)
    with pytest.raises(UserError, match='another search'):
        structure_search(problem, SETTINGS, log, seed=1, structures=STRUCTURES, repeats=4)


def test_takes_the_smaller_on_a_tie() -> None:
    rng = np.random.default_rng(0)
    draw = rng.normal(size=(3, 20))
    scores = {(2,): 5.0 + draw[0], (10,): draw[1], (50, 50): draw[2] - 0.05}
    assert choose({k: v.tolist() for k, v in scores.items()}, 14) == (10,)
    scores[10,] = draw[1] + 2.0
    assert choose({k: v.tolist() for k, v in scores.items()}, 14) == (50, 50)
