"""All results of the page on [B19], one step after the other, each kept in a file of its own."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from hydro_twin.files import write_whole
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.network import SETTINGS
from hydro_twin.fitting.network_search import choose, Scores
from hydro_twin.fitting.physics import fit_physics, Task
from hydro_twin.model import Model
from hydro_twin.plants import plant_named
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.kind import Settings
from hydro_twin.predictors.predictor import MODES
from hydro_twin.predictors.scores import errors_of
from hydro_twin.recording.rig import read, Rig, rig_of
from hydro_twin.recording.series import Recording, split
from hydro_twin.share import share_folder
from hydro_twin.studies.b19 import choices, outlook
from hydro_twin.studies.b19.populations import fit_one_step
from hydro_twin.studies.b19.settings import network_models, searches
from hydro_twin.studies.b19.study import (
    make_part,
    network_runs,
    Part,
    PARTS,
    Run,
    Study,
    study,
)

RUNS = 20
OUTLOOK_RUNS = 5            # of each network, of which one takes up to ten seconds
BLOCK_REPEATS = 10
MILD = ('rig_a', 'rig_b', 'rig_c')
MILD_RUNS = 3
DIGITS = 6                  # of what is kept: enough to rank runs
EPOCHS_DRAWN = np.unique(np.round(np.geomspace(1, 500, 60)).astype(int)) - 1


@dataclass(frozen=True)
class Job:
    """What the steps work on.

    Attributes:
        work: folder of what is kept between runs.
        runs: of each method.
        device: where networks are trained.
        leg: folder of the measured recordings; None where they are not there.
    """

    work: Path
    runs: int = RUNS
    device: str = 'cpu'
    leg: Path | None = None

    @cached_property
    def rig(self) -> Rig:
        """The rig of the sample recording."""
        return rig_of(plant_named('load_simulator'))

    @cached_property
    def recording(self) -> Recording:
        """The sample recording."""
        return read([share_folder() / 'bags' / 'load_simulator_nonlinear'], self.rig)

    @cached_property
    def recordings(self) -> dict[str, Recording]:
        """Its training and its test part."""
        return dict(zip(PARTS, split(self.recording), strict=True))

    @cached_property
    def parts(self) -> dict[str, Part]:
        """The same, with their factors."""
        return {name: make_part(name, recording, self.rig.plant)
                for name, recording in self.recordings.items()}

    @property
    def seeds(self) -> range:
        """Of the runs."""
        return range(self.runs)

    @property
    def outlook_seeds(self) -> range:
        """Of the runs of the outlook."""
        return range(min(self.runs, OUTLOOK_RUNS))


def settings(job: Job) -> dict[str, Any]:
    """Search weight decay and structure on a third of the training patterns, Sect. 3.2."""
    found = searches(job.recordings['train'], job.rig.plant, job.rig.constants,
                     job.work / '{}.search.jsonl', 0, job.device, lambda: None)
    return {kind: [{'candidates': _laid_out(one.scores), 'chosen': _settings(one.chosen)}
                   for one in rounds] for kind, rounds in found.items()}


def chosen_settings(job: Job) -> dict[str, Settings]:
    """Read what the search chose."""
    rounds = run_step('settings', job)
    return {kind: replace(SETTINGS[kind], hidden=tuple(found[-1]['chosen']['hidden']),
                          decay=found[-1]['chosen']['decay']) for kind, found in rounds.items()}


def published(job: Job) -> dict[str, Any]:
    """Run the study with the settings of Tables 2 and 3."""
    return _study(study(job.recordings['train'], job.recordings['test'], job.rig.plant,
                        job.rig.constants, job.runs, device=job.device))


def chosen(job: Job) -> dict[str, Any]:
    """Train the networks with the settings that the search chose."""
    models = network_models(job.recordings['train'], job.rig.plant, job.rig.constants, 0)
    return {kind: _runs(list(network_runs(models[kind], found, job.parts, job.seeds, job.device)))
            for kind, found in chosen_settings(job).items()}


def swapped(job: Job) -> dict[str, Any]:
    """Run the study with training and test part swapped, with the settings of the paper."""
    return _study(study(job.recordings['test'], job.recordings['train'], job.rig.plant,
                        job.rig.constants, job.runs, device=job.device))


def physics(job: Job) -> dict[str, Any]:
    """Fit the linear model to its free run, and see what PSO takes for K_sv."""
    plant, constants = job.rig.plant, job.rig.constants
    asked = {'free_run': ('least_squares', 'free_run', 0),
             **{f'pso {seed}': ('pso', 'one_step', seed) for seed in range(3)},
             'one_step': ('least_squares', 'one_step', 0)}
    fits = {name: fit_physics(Task(job.recordings['train'], plant, constants, criterion, seed, {}),
                              method) for name, (method, criterion, seed) in asked.items()}
    sample_time = job.recordings['train'].sample_time
    models = {name: Model(plant, {**constants, **fit.values}, sample_time)
              for name, fit in fits.items()}
    return {name: {'parameters': {key: p.value for key, p in model.parameters.items()},
                   'errors': errors_of(Analytical(model), job.recordings)}
            for name, model in models.items()}


def mild(job: Job) -> dict[str, Any]:
    """Compare least squares and the MLP, one step, on the rigs that lack less."""
    found = {}
    for name in MILD:
        train, test = split(read([share_folder() / 'bags' / name], job.rig))
        recordings = {'train': train, 'test': test}
        factors = {part: make_part(part, recording, job.rig.plant).factor
                   for part, recording in recordings.items()}
        coefficients = coefficients_of(job.rig.plant, job.rig.constants, train.sample_time)
        best = fit_one_step('least_squares', factors['train'], coefficients, job.rig.plant, 0).best
        mlp = network_models(train, job.rig.plant, job.rig.constants, 0)['mlp']
        found[name] = {
            'least_squares': float(factors['test'].rms(coefficients(best[None])[0])),
            'mlp': choices.one_step_errors(
                choices.problems_of(mlp, recordings), SETTINGS['mlp'],
                range(min(job.runs, MILD_RUNS)), job.device)['test']}
    return found


def alignment(job: Job) -> dict[str, Any]:
    """Repeat the study with inputs one sample late."""
    return choices.aligned(job.recordings, job.rig.plant, job.rig.constants, job.seeds, job.device)


def box(job: Job) -> dict[str, Any]:
    """Fit in wider boxes, and with other D_m."""
    return choices.box(job.parts, job.rig.plant, job.rig.constants, 0)


def optimisers(job: Job) -> dict[str, Any]:
    """Run the optimisers with other choices."""
    return choices.optimisers(job.parts, job.rig.plant, job.rig.constants, job.seeds)


def networks(job: Job) -> dict[str, Any]:
    """Train networks with other choices."""
    return choices.networks(job.recordings, job.rig.plant, job.rig.constants, job.seeds,
                            job.device)


def validation(job: Job) -> dict[str, Any]:
    """Choose the MLP's decay on contiguous validation data instead."""
    models = network_models(job.recordings['train'], job.rig.plant, job.rig.constants, 0)
    problem = choices.problems_of(models['mlp'], job.recordings)['train']
    candidates = [replace(SETTINGS['mlp'], decay=decay) for decay in (0.0, 5e-6, 5e-4)]
    scores = choices.block_validation(problem, candidates, range(min(job.runs, BLOCK_REPEATS)),
                                      job.device)
    return {'candidates': _laid_out(scores), 'chosen': _settings(choose(scores, 14))}


def frequencies(job: Job) -> dict[str, Any]:
    """Train on the frequencies of the paper, or on higher ones too; test on both."""
    bag = job.work / 'higher'
    higher = (read([bag], job.rig) if bag.exists()
              else outlook.at_higher_frequencies(bag, job.rig))
    train, test = split(higher)
    tests = {'paper': job.recordings['test'], 'higher': test}
    return {name: outlook.predictors(recording, tests, job.rig, job.outlook_seeds, job.device)
            for name, recording in (('paper', job.recordings['train']),
                                    ('all', job.recordings['train'] + train))}


def measured(job: Job) -> dict[str, Any] | None:
    """Compare the predictors on the measured leg, where its recordings are there."""
    if job.leg is None:
        return None
    job.work.mkdir(parents=True, exist_ok=True)
    (recording, sweep), rig = outlook.leg(job.leg, job.work, 'load_simulator')
    train, test = split(recording)
    return outlook.predictors(train, {'1 Hz': test, 'sweep': sweep}, rig, job.outlook_seeds,
                              job.device, kinds=('mlp', 'gru'))


STEPS: dict[str, Callable[[Job], Any]] = {
    'box': box, 'optimisers': optimisers, 'physics': physics, 'mild': mild,
    'published': published, 'swapped': swapped, 'networks': networks, 'alignment': alignment,
    'settings': settings, 'chosen': chosen, 'validation': validation,
    'frequencies': frequencies, 'measured': measured}


def run_step(name: str, job: Job) -> Any:
    """Run a step, or read what it left when it was run before."""
    path = job.work / f'{name}.json'
    if not path.exists():
        job.work.mkdir(parents=True, exist_ok=True)
        found = rounded(STEPS[name](job))
        if found is None:
            return None
        write_whole(path, json.dumps(found, allow_nan=False))
    return json.loads(path.read_text(encoding='utf-8'))


def rounded(value: Any) -> Any:
    """Round all numbers to DIGITS; an infinite one, of a run that diverged, becomes None."""
    match value:
        case bool() | int() | str() | None:
            return value
        case float():
            return float(f'{value:.{DIGITS}g}') if math.isfinite(value) else None
        case Mapping():
            return {str(key): rounded(item) for key, item in value.items()}
        case _:
            return [rounded(item) for item in value]


def _study(found: Study) -> dict[str, Any]:
    return {'runs': {method: _runs(runs) for method, runs in found.runs.items()},
            'patterns': found.patterns, 'persistence': found.persistence,
            'unconstrained': found.unconstrained}


def _runs(runs: Sequence[Run]) -> dict[str, Any]:
    laid_out: dict[str, Any] = {
        part: {mode: [run.errors[part, mode] for run in runs] for mode in MODES}
        for part in PARTS}
    curves = [run.test_curve for run in runs if run.test_curve is not None]
    if curves:
        laid_out['test_curve'] = np.mean(curves, axis=0)[EPOCHS_DRAWN].tolist()
    return laid_out


def _settings(found: Settings) -> dict[str, Any]:
    return {'hidden': list(found.hidden), 'decay': found.decay}


def _laid_out(scores: Scores) -> list[dict[str, Any]]:
    return [{**_settings(candidate), 'validation': errors} for candidate, errors in scores.items()]
