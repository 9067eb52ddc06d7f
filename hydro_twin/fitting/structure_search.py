"""The structure search of [B19]: the smallest network that none beats beyond chance."""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
import hashlib
from itertools import pairwise
import json
from pathlib import Path

import numpy as np
from scipy.stats import mannwhitneyu

from hydro_twin.errors import UserError
from hydro_twin.fitting.network import Job, Problem, Settings, train_many
from hydro_twin.predictors.network import IntArray

WIDTHS = (1, 2, 4, 7, 11, 16, 23, 33, 46, 60, 77, 100)
STRUCTURES = (*((width,) for width in WIDTHS), *((width, width) for width in WIDTHS))
REPEATS = 20
LEVEL = 0.05                # of the Mann-Whitney test

Hidden = tuple[int, ...]


@dataclass(frozen=True)
class Trial:
    """One network of the search, with its RMS errors in the output's unit."""

    hidden: Hidden
    repeat: int
    train: float
    validation: float


def structure_search(
    problem: Problem, settings: Settings, log: Path, seed: int = 0, device: str = 'cpu',
    structures: Sequence[Hidden] = STRUCTURES, repeats: int = REPEATS,
    trial_done: Callable[[], object] = lambda: None,
) -> dict[Hidden, list[float]]:
    """Train networks of every structure on two thirds of the patterns, and score them on the rest.

    Repeat r draws the same patterns for every structure. Each trial is appended to a file as it
    ends, so that a search that was interrupted goes on where it stopped.

    Args:
        problem: what to learn.
        settings: all but the hidden layers.
        log: JSON lines, created if it is not there.
        seed: of the splits and the weights.
        device: as in `train_many`.
        structures: widths of the hidden layers to try.
        repeats: networks of each structure.
        trial_done: called for every trial, also for those found in the file.

    Returns:
        For every structure the validation errors of its repeats, in the output's unit.

    Raises:
        UserError: the file belongs to another search.
    """
    done = resume(log, fingerprint(problem, settings, seed))
    wanted = [(hidden, repeat) for hidden in structures for repeat in range(repeats)]
    missing = [key for key in wanted if key not in done]
    splits = {repeat: split(len(problem.targets), seed, repeat) for repeat in range(repeats)}
    jobs = [Job(Settings(hidden, settings.epochs, settings.decay), seed + repeat,
                splits[repeat][0]) for hidden, repeat in missing]
    for _ in range(len(wanted) - len(missing)):
        trial_done()
    with log.open('a', encoding='utf-8') as file:
        for (hidden, repeat), trained in zip(missing, train_many(problem, jobs, device),
                                             strict=True):
            error = trained.network(problem.regressors) - problem.targets
            train, validation = (float(np.sqrt(np.mean(error[rows] ** 2)))
                                 for rows in splits[repeat])
            done[hidden, repeat] = Trial(hidden, repeat, train, validation)
            file.write(json.dumps(asdict(done[hidden, repeat])) + '\n')
            file.flush()
            trial_done()
    scores = defaultdict(list)
    for hidden, repeat in wanted:
        scores[hidden].append(done[hidden, repeat].validation)
    return dict(scores)


def choose(scores: Mapping[Hidden, Sequence[float]], regressors: int) -> Hidden:
    """Choose the smallest structure that the best does not beat significantly.

    Args:
        scores: errors of the repeats of every structure.
        regressors: number of inputs, for the size of a network.
    """
    def size(hidden: Hidden) -> int:
        layers = (regressors, *hidden, 1)
        return sum((rows + 1) * columns for rows, columns in pairwise(layers))

    best = min(scores, key=lambda hidden: (np.median(scores[hidden]), size(hidden)))
    return min((hidden for hidden in scores if hidden == best or mannwhitneyu(
        scores[hidden], scores[best]).pvalue > LEVEL), key=size)


def split(patterns: int, seed: int, repeat: int) -> tuple[IntArray, IntArray]:
    """Draw two thirds of the patterns to train on, and the rest to validate."""
    drawn = np.random.default_rng([seed, repeat]).permutation(patterns)
    cut = 2 * patterns // 3
    return np.sort(drawn[:cut]), np.sort(drawn[cut:])


def fingerprint(problem: Problem, settings: Settings, seed: int) -> str:
    """Name a search by what its trials depend on."""
    digest = hashlib.sha256(repr((settings.epochs, settings.decay, seed)).encode())
    for array in (problem.regressors, problem.targets, problem.shift, problem.scale):
        digest.update(array.tobytes())
    return digest.hexdigest()


def resume(log: Path, search: str) -> dict[tuple[Hidden, int], Trial]:
    """Read the trials of a search that was interrupted; begin the file if there is none.

    Raises:
        UserError: the file belongs to another search.
    """
    head = json.dumps({'search': search})
    lines = log.read_text(encoding='utf-8').splitlines() if log.exists() else []
    if lines and lines[0] != head:
        raise UserError(f'{log}: holds another search, of other data or settings; '
                        'move it away or name another file')
    trials = {}
    for line in lines[1:]:
        try:
            raw = json.loads(line)
            trial = Trial(tuple(raw['hidden']), raw['repeat'], raw['train'], raw['validation'])
        except (ValueError, KeyError, TypeError):
            continue            # cut short when the search was interrupted
        trials[trial.hidden, trial.repeat] = trial
    whole = [head, *(json.dumps(asdict(trial)) for trial in trials.values())]
    beside = log.with_name(f'.{log.name}')
    beside.write_text('\n'.join(whole) + '\n', encoding='utf-8')
    beside.replace(log)
    return trials
