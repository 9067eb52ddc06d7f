"""What [B19] leaves open, each with what another choice gives."""
from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
import math
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.network import Job, Problem, SETTINGS, train_many
from hydro_twin.fitting.network_search import Scores
from hydro_twin.fitting.one_step import at_bound, least_squares, one_step_error, SearchResult
from hydro_twin.fitting.refit import network_problem
from hydro_twin.model import Model
from hydro_twin.parallel import in_processes
from hydro_twin.plants import Plant
from hydro_twin.predictors.kind import Settings
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Recording
from hydro_twin.studies.b19.bees import bees
from hydro_twin.studies.b19.evolution import evolution
from hydro_twin.studies.b19.particle_swarm import particle_swarm
from hydro_twin.studies.b19.populations import fit_one_step
from hydro_twin.studies.b19.settings import network_models
from hydro_twin.studies.b19.study import make_part, model_of, Part, PARTS

OPTIMISERS: dict[str, Callable[..., SearchResult]] = {
    'EA: wheel 1/error^2, a sigma for each gene': evolution,
    'EA: wheel 1/error': partial(evolution, power=1.0),
    'EA: wheel 1/error^8': partial(evolution, power=8.0),
    'EA: one sigma for each individual': partial(evolution, sigmas='individual'),
    'PSO: 0.1 of the box in a cycle at most': particle_swarm,
    'PSO: 0.5 of the box': partial(particle_swarm, speed_limit=0.5),
    'PSO: only the walls': partial(particle_swarm, speed_limit=math.inf),
    'BA: first patch 0.5 of the box either side, shrinks by 0.8': bees,
    'BA: first patch 0.1': partial(bees, first_patch=0.1),
    'BA: shrinks by 0.5': partial(bees, shrink=0.5),
}

BOXES = (1.0, 1.5, 2.0, 3.0, 10.0)              # factors of the box, down and up
DISPLACEMENTS = (1e-5, 2e-5, 5e-5, 1e-4)        # D_m, which Table 1 lacks [m^3/rad]

Errors = dict[str, list[float]]                 # part -> one-step errors of the runs


def delayed(recording: Recording, inputs: Sequence[str]) -> Recording:
    """Pair each output with the inputs of the sample before, Sect. 3 of [B19] read literally."""
    return replace(recording, series=tuple(
        replace(series, columns={
            name: np.concatenate([column[:1], column[:-1]]) if name in inputs else column
            for name, column in series.columns.items()})
        for series in recording.series))


def optimisers(
    parts: Mapping[str, Part], plant: Plant, constants: Mapping[str, float], seeds: Sequence[int],
) -> dict[str, Errors]:
    """Run the optimisers with each choice; one-step errors by choice."""
    coefficients = coefficients_of(plant, constants, parts['train'].recording.sample_time)
    lower, upper = np.array([(p.lower, p.upper) for p in plant.parameters]).T
    objective = one_step_error(parts['train'].factor, coefficients)
    found = {}
    for name, optimise in OPTIMISERS.items():
        best = [optimise(objective, lower, upper, seed).best for seed in seeds]
        found[name] = {part: parts[part].factor.rms(coefficients(np.array(best))).tolist()
                       for part in PARTS}
    return found


def box(
    parts: Mapping[str, Part], plant: Plant, constants: Mapping[str, float], seed: int,
) -> dict[str, Any]:
    """Fit by least squares in wider boxes, and with other D_m.

    Returns:
        'boxes' and 'displacements': one-step errors by part and the parameters at the edge, by
        factor and by D_m.
    """
    names = [p.name for p in plant.parameters]
    lower, upper = np.array([(p.lower, p.upper) for p in plant.parameters]).T

    def fitted(factor: float, constants: Mapping[str, float]) -> dict[str, Any]:
        coefficients = coefficients_of(plant, constants,
                                       parts['train'].recording.sample_time)
        low, high = lower / factor, upper * factor
        best = least_squares(parts['train'].factor, coefficients, names, plant.combinations, low,
                             high, seed).best
        c = coefficients(best[None])[0]
        return {**{name: float(part.factor.rms(c)) for name, part in parts.items()},
                'at_bound': list(at_bound(names, best, low, high))}

    return {'boxes': {f'{factor:g}': fitted(factor, constants) for factor in BOXES},
            'displacements': {f'{D_m:g}': fitted(1.0, {**constants, 'D_m': D_m})
                              for D_m in DISPLACEMENTS}}


def one_step_errors(
    problems: Mapping[str, Problem], settings: Settings, seeds: Sequence[int], device: str,
) -> Errors:
    """Train networks on the training part; one-step errors by part."""
    errors: Errors = {part: [] for part in PARTS}
    for trained in train_many(problems['train'], [Job(settings, s) for s in seeds], device):
        for part, problem in problems.items():
            errors[part].append(rms(problems['train'].error(trained.network, problem)))
    return errors


def problems_of(model: Model, parts: Mapping[str, Recording]) -> dict[str, Problem]:
    """Collect what the network of a model is to learn, by part."""
    return {part: network_problem(recording, model) for part, recording in parts.items()}


def aligned(
    parts: Mapping[str, Recording], plant: Plant, constants: Mapping[str, float],
    seeds: Sequence[int], device: str,
) -> dict[str, Any]:
    """Repeat the one-step study with inputs one sample late; errors by method and part."""
    inputs = [signal.name for signal in plant.inputs]
    late = {name: delayed(recording, inputs) for name, recording in parts.items()}
    made = {name: make_part(name, recording, plant) for name, recording in late.items()}
    coefficients = coefficients_of(plant, constants, parts['train'].sample_time)
    best = fit_one_step('least_squares', made['train'].factor, coefficients, plant, seeds[0]).best
    rows = {'least_squares': coefficients(best[None])[0],
            'unconstrained': made['train'].factor.best()}
    linear = {method: {part: [float(made[part].factor.rms(c))] for part in PARTS}
              for method, c in rows.items()}
    models = network_models(late['train'], plant, constants, seeds[0])
    return linear | {kind: one_step_errors(problems_of(model, late), SETTINGS[kind], seeds, device)
                     for kind, model in models.items()}


def networks(
    parts: Mapping[str, Recording], plant: Plant, constants: Mapping[str, float],
    seeds: Sequence[int], device: str,
) -> dict[str, Errors]:
    """Train the networks of Table 3 with another output, scale or base; errors by choice."""
    models = network_models(parts['train'], plant, constants, seeds[0])
    factor = make_part('training', parts['train'], plant).factor
    coefficients = coefficients_of(plant, constants, parts['train'].sample_time)
    bees_runs = [fit_one_step('bees', factor, coefficients, plant, seed) for seed in seeds]
    base = model_of('hybrid', min(bees_runs, key=lambda run: run.error).best, plant, constants,
                    parts['train'].sample_time)
    mlp, hybrid = (problems_of(models[kind], parts) for kind in ('mlp', 'hybrid'))
    coarse = {part: replace(problem, output_scale=plant.output_scale)
              for part, problem in hybrid.items()}
    return {
        'MLP: linear output unit': one_step_errors(mlp, SETTINGS['mlp'], seeds, device),
        'MLP: tanh output unit': bounded_errors(mlp, SETTINGS['mlp'], seeds),
        'hybrid: on least squares, error over 3 std': one_step_errors(
            hybrid, SETTINGS['hybrid'], seeds, device),
        'hybrid: error over 200 N m': one_step_errors(coarse, SETTINGS['hybrid'], seeds, device),
        'hybrid: on the best run of the BA': one_step_errors(
            problems_of(base, parts), SETTINGS['hybrid'], seeds, device),
    }


def bounded_errors(
    problems: Mapping[str, Problem], settings: Settings, seeds: Sequence[int],
) -> Errors:
    """Train MLPs whose output unit is a tanh; one-step errors by part."""
    train = problems['train']

    def run(seed: int) -> dict[str, float]:
        from hydro_twin.fitting import rprop
        from hydro_twin.fitting.network import initial_weights

        x, y = (rprop.as_tensor(a[None], 'cpu') for a in train.scaled(train))
        sizes = [x.shape[2], *settings.hidden, 1]
        weights, *_ = rprop.train(
            lambda w, out: rprop.gradient(w, sizes, x, y[..., None], settings.decay, out,
                                          bounded=True),
            initial_weights(sizes, seed)[None], settings.epochs, 'cpu', lambda: None)
        network = replace(train, output_scale=1.0).network(settings, weights[0])
        return {part: rms(train.output_scale * np.tanh(network(problem.regressors))
                          - problem.targets) for part, problem in problems.items()}

    found = list(in_processes(run, seeds))
    return {part: [errors[part] for errors in found] for part in PARTS}


def block_validation(
    problem: Problem, candidates: Sequence[Settings], seeds: Sequence[int], device: str,
) -> Scores:
    """Score settings on the last third of each stretch, instead of patterns drawn at random."""
    begins = np.cumsum([0, *problem.lengths])
    cuts = [begin + 2 * n // 3 for begin, n in zip(begins, problem.lengths, strict=False)]
    train = np.concatenate([np.arange(b, c) for b, c in zip(begins, cuts, strict=False)])
    rest = np.setdiff1d(np.arange(begins[-1]), train)
    jobs = [Job(settings, seed, train) for settings in candidates for seed in seeds]
    errors = iter(_validated(problem, jobs, rest, device))
    return {settings: [next(errors) for _ in seeds] for settings in candidates}


def _validated(
    problem: Problem, jobs: Sequence[Job], rows: FloatArray, device: str,
) -> Iterator[float]:
    for trained in train_many(problem, jobs, device):
        yield rms(problem.error(trained.network, problem)[rows])
