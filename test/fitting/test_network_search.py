"""The search of decay and structure: its choice, and that it goes on where it stopped."""
from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
import json
from pathlib import Path

import numpy as np
import pytest

from hydro_twin.errors import UserError
from hydro_twin.fitting.network import Job, Problem, train_batch
from hydro_twin.fitting.network_search import choose, draw_split, score, Scores, search
from hydro_twin.predictors.kind import Settings

# Not imported to be looked for: that takes seconds of each process that collects the tests.
pytestmark = pytest.mark.skipif(find_spec('torch') is None, reason='needs torch')

SMALL, LARGE = (Settings(hidden, 60, 0.0) for hidden in ((1,), (8,)))


@pytest.fixture(autouse=True)
def one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('os.sched_getaffinity', lambda _: {0})


@pytest.fixture
def problem() -> Problem:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (150, 3))
    return Problem(x, np.sin(4 * x[:, 0]) * x[:, 1], np.zeros(3), np.ones(3), 1.0, 100.0)


def scored(problem: Problem, log: Path) -> Scores:
    return score(problem, [SMALL, LARGE], log, repeats=4)


@pytest.mark.slow
def test_goes_on_where_it_stopped(problem: Problem, tmp_path: Path) -> None:
    log = tmp_path / 'search.jsonl'
    scores = scored(problem, log)
    lines = log.read_text().splitlines()
    assert len(lines) == 9
    kept = [json.loads(line) for line in lines[1:4]]
    kept[0]['validation'] = 123.0               # shows that it is read, not trained again
    log.write_text('\n'.join([lines[0], *map(json.dumps, kept), lines[4][:20]]))
    resumed = scored(problem, log)
    assert resumed[SMALL][0] == 123.0
    assert (resumed[SMALL][1:], resumed[LARGE]) == (scores[SMALL][1:], scores[LARGE])
    assert len(log.read_text().splitlines()) == 9
    assert scored(problem, log) == resumed      # with nothing left to train


def test_validates_on_patterns_not_trained_on(problem: Problem, tmp_path: Path) -> None:
    log = tmp_path / 'search.jsonl'
    scores = scored(problem, log)
    assert choose(scores, 3) == LARGE
    train, rest = draw_split(150, 0, 1)
    assert sorted([*train, *rest]) == list(range(150))
    assert len(train) == 100
    assert not np.array_equal(train, draw_split(150, 0, 2)[0])
    network = train_batch(problem, [Job(LARGE, 1, train)])[0].network
    error = problem.error(network, problem)[rest]
    assert scores[LARGE][1] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)
    error = problem.error(network, problem)[train]
    assert scores[LARGE][1] != pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-3)


def test_refuses_the_file_of_another_search(problem: Problem, tmp_path: Path) -> None:
    log = tmp_path / 'search.jsonl'
    scored(problem, log)
    with pytest.raises(UserError, match='another search, of other data or another seed'):
        score(problem, [SMALL, LARGE], log, seed=1, repeats=4)
    whole = log.read_bytes()
    log.write_bytes(b'\xff' + whole)
    with pytest.raises(UserError, match='another search'):
        scored(problem, log)
    assert log.read_bytes() == b'\xff' + whole


def test_a_damaged_line_is_a_trial_to_repeat(problem: Problem, tmp_path: Path) -> None:
    log = tmp_path / 'search.jsonl'
    scores = scored(problem, log)
    lines = log.read_bytes().splitlines()
    log.write_bytes(b'\n'.join([*lines[:3], lines[3].replace(b'"train"', b'"tr\xffin"'),
                                *lines[4:]]))
    assert scored(problem, log) == scores


def test_takes_the_smaller_on_a_tie() -> None:
    rng = np.random.default_rng(0)
    draw = rng.normal(size=(3, 20))
    small, middle, large = (Settings(hidden) for hidden in ((2,), (10,), (50, 50)))
    scores = {small: 5.0 + draw[0], middle: draw[1], large: draw[2] - 0.05}
    assert choose({k: v.tolist() for k, v in scores.items()}, 14) == middle
    scores[middle] = draw[1] + 2.0
    assert choose({k: v.tolist() for k, v in scores.items()}, 14) == large


def test_takes_the_least_mean_among_decays() -> None:
    """One outlier makes the mean of the second, which has the least median, worse."""
    first, second = Settings(decay=0.0), Settings(decay=1e-3)
    scores = {first: [2.0, 2.1, 2.2, 2.3], second: [1.9, 1.9, 1.9, 9.0]}
    assert choose(scores, 14) == first
    assert choose({first: [5.0] * 20, second: [4.0] * 20}, 14) == second


def test_searches_the_decay_of_a_new_structure_again(problem: Problem, tmp_path: Path) -> None:
    decays, structures = (0.0, 1e-6), ((1,), (8,))
    rounds = search(problem, SMALL, tmp_path / 'search.jsonl', decays=decays,
                    structures=structures, repeats=4)
    best = rounds[0].chosen.decay
    assert [{(s.hidden, s.decay) for s in one.scores} for one in rounds] == [
        {((1,), decay) for decay in decays}, {((1,), best), ((8,), best)},
        {((8,), decay) for decay in decays}]
    assert [one.chosen.hidden for one in rounds] == [(1,), (8,), (8,)]
    kept = search(problem, SMALL, tmp_path / 'other.jsonl', decays=(0.0,),
                  structures=((1,),), repeats=4)
    assert kept[-1].chosen == SMALL         # what is given stays


def test_a_gru_is_scored_stretch_by_stretch(problem: Problem) -> None:
    """Its state starts from zero in each stretch: the error of both is that of each."""
    whole = replace(problem, lengths=(100, 50))
    cut = slice(100, 150)
    second = replace(problem, regressors=problem.regressors[cut], targets=problem.targets[cut],
                     lengths=(50,))
    network = train_batch(whole, [Job(Settings((4,), 3, 0.0, 'gru'), 0)])[0].network
    np.testing.assert_array_equal(whole.error(network, whole)[cut],
                                  second.error(network, second))
