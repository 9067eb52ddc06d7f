"""The search of [B19] for the structure and the weight decay of a network, on validation data."""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
import hashlib
from itertools import pairwise
import json
from pathlib import Path

import numpy as np
import scipy

from hydro_twin.arrays import IntArray
from hydro_twin.errors import UserError
from hydro_twin.files import write_whole
from hydro_twin.fitting.network import Job, Problem, train_many
from hydro_twin.predictors.kind import Settings

# 1 to 100 units, as the paper, whose two results are among them.
WIDTHS = (1, 3, 7, 15, 30, 50, 80, 100)
STRUCTURES = (*((width,) for width in WIDTHS), *((width, width) for width in WIDTHS), (77, 77))
DECAYS = (0.0, 5e-6, 5e-5, 5e-4, 5e-3)      # decades about the paper's; more of it only hurts
REPEATS = 20
LEVEL = 0.05                # of the Mann-Whitney test

Scores = dict[Settings, list[float]]        # validation errors of the repeats


@dataclass(frozen=True)
class Trial:
    """One network of the search, with its RMS errors in the output's unit."""

    settings: Settings
    repeat: int
    train: float
    validation: float


@dataclass(frozen=True)
class Round:
    """One round of a search: what was tried, and what was chosen."""

    scores: Scores
    chosen: Settings


def search(
    problem: Problem, first: Settings, log: Path, seed: int = 0, device: str = 'cpu',
    decays: Sequence[float] = DECAYS, structures: Sequence[tuple[int, ...]] = STRUCTURES,
    repeats: int = REPEATS, trial_done: Callable[[], object] = lambda: None,
) -> list[Round]:
    """Search the weight decay, then the structure, then the decay of a new structure.

    Args:
        problem: what to learn.
        first: where the search starts; its epochs stay.
        log: as in `score`.
        seed: of the splits and the weights.
        device: as in `train_many`.
        decays: to try; one leaves it as it is.
        structures: widths of the hidden layers to try; one leaves them as they are.
        repeats: networks of each candidate.
        trial_done: called after every network.

    Returns:
        The rounds; the last one's choice is the result.

    Raises:
        UserError: the file belongs to another search.
    """
    rounds: list[Round] = []

    def run(candidates: Sequence[Settings]) -> Settings:
        scores = score(problem, candidates, log, seed, device, repeats, trial_done)
        rounds.append(Round(scores, choose(scores, problem.regressors.shape[1])))
        return rounds[-1].chosen

    chosen = run([replace(first, decay=decay) for decay in decays])
    chosen = run([replace(chosen, hidden=hidden) for hidden in structures])
    if chosen.hidden != first.hidden and len(decays) > 1:
        run([replace(chosen, decay=decay) for decay in decays])
    return rounds


def score(
    problem: Problem, candidates: Sequence[Settings], log: Path, seed: int = 0,
    device: str = 'cpu', repeats: int = REPEATS,
    trial_done: Callable[[], object] = lambda: None,
) -> Scores:
    """Train every candidate on two thirds of the patterns, and score it on the rest.

    Repeat r draws the same patterns for every candidate. Each trial is appended to a file as it
    ends, so that an interrupted search resumes where it stopped.

    Args:
        problem: what to learn.
        candidates: to try.
        log: JSON lines, created if it is not there.
        seed: of the splits and the weights.
        device: as in `train_many`.
        repeats: networks of each candidate.
        trial_done: called for every trial, also for those found in the file.

    Returns:
        For every candidate the validation errors of its repeats, in the output's unit.

    Raises:
        UserError: the file belongs to another search.
    """
    done = resume(log, fingerprint(problem, seed))
    wanted = [(settings, repeat) for settings in candidates for repeat in range(repeats)]
    missing = [key for key in wanted if key not in done]
    splits = {repeat: draw_split(len(problem.targets), seed, repeat) for repeat in range(repeats)}
    jobs = [Job(settings, seed + repeat, splits[repeat][0]) for settings, repeat in missing]
    for _ in range(len(wanted) - len(missing)):
        trial_done()
    with log.open('a', encoding='utf-8') as file:
        for (settings, repeat), trained in zip(missing, train_many(problem, jobs, device),
                                               strict=True):
            error = problem.error(trained.network, problem)
            train, validation = (float(np.sqrt(np.mean(error[rows] ** 2)))
                                 for rows in splits[repeat])
            done[settings, repeat] = Trial(settings, repeat, train, validation)
            file.write(json.dumps(asdict(done[settings, repeat])) + '\n')
            file.flush()
            trial_done()
    scores = defaultdict(list)
    for settings, repeat in wanted:
        scores[settings].append(done[settings, repeat].validation)
    return dict(scores)


def choose(scores: Mapping[Settings, Sequence[float]], regressors: int) -> Settings:
    """Choose the smallest network that the best, by its mean error, does not beat significantly.

    Among those of the same size the one of the least mean error: [B19] has no rule for the decay.

    Args:
        scores: errors of the repeats of every candidate.
        regressors: number of inputs, for the size of a network.
    """
    def key(settings: Settings) -> tuple[int, float]:
        layers = (regressors, *settings.hidden, 1)
        size = sum((rows + 1) * columns for rows, columns in pairwise(layers))
        return size, float(np.mean(scores[settings]))

    best = min(scores, key=lambda settings: (key(settings)[1], key(settings)[0]))
    return min((settings for settings in scores if settings == best or scipy.stats.mannwhitneyu(
        scores[settings], scores[best]).pvalue > LEVEL), key=key)


def draw_split(patterns: int, seed: int, repeat: int) -> tuple[IntArray, IntArray]:
    """Draw two thirds of the patterns to train on, and the rest to validate."""
    drawn = np.random.default_rng([seed, repeat]).permutation(patterns)
    cut = 2 * patterns // 3
    return np.sort(drawn[:cut]), np.sort(drawn[cut:])


def fingerprint(problem: Problem, seed: int) -> str:
    """Name a search by what all its trials depend on."""
    digest = hashlib.sha256(repr(seed).encode())
    for array in (problem.regressors, problem.targets, problem.shift, problem.scale):
        digest.update(array.tobytes())
    return digest.hexdigest()


def resume(log: Path, search: str) -> dict[tuple[Settings, int], Trial]:
    """Read the trials of a search that was interrupted; begin the file if there is none.

    Raises:
        UserError: the file belongs to another search.
    """
    head = json.dumps({'search': search})
    # What is damaged replaces no more than its own line.
    lines = log.read_text('utf-8', 'replace').splitlines() if log.exists() else []
    if lines and lines[0] != head:
        raise UserError(f'{log}: holds another search, of other data or another seed; '
                        'move it away or name another file')
    trials = {}
    for line in lines[1:]:
        try:
            raw = json.loads(line)
            settings = Settings(**{**raw['settings'], 'hidden': tuple(raw['settings']['hidden'])})
            trial = Trial(settings, raw['repeat'], raw['train'], raw['validation'])
        except (ValueError, KeyError, TypeError):
            continue            # cut short when the search was interrupted
        trials[settings, trial.repeat] = trial
    whole = [head, *(json.dumps(asdict(trial)) for trial in trials.values())]
    write_whole(log, '\n'.join(whole) + '\n')
    return trials
