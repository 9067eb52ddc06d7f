"""The study of [B19]: optimisers and networks over repeated runs, on training and test data."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
from scipy.stats import mannwhitneyu

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.network import Job, SETTINGS, train_many
from hydro_twin.fitting.one_step import SearchResult
from hydro_twin.fitting.parts import parts_of
from hydro_twin.fitting.refit import network_problem
from hydro_twin.fitting.regression import Regression, regression
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.kind import Settings
from hydro_twin.predictors.network_predictor import NetworkPredictor
from hydro_twin.predictors.predictor import Predictor
from hydro_twin.predictors.scores import errors_of, persistence
from hydro_twin.recording.series import Recording
from hydro_twin.studies.b19.populations import fit_one_step

TITLES = {'random': 'RG', 'ea': 'EA', 'bees': 'BA', 'pso': 'PSO', 'mlp': 'MLP',
          'hybrid': 'hybrid', 'least_squares': 'LS'}
PARTS = ('train', 'test')

HUGE = 1e200        # stands for infinity where quartiles are interpolated

Key = tuple[str, str]                       # part, mode


@dataclass(frozen=True)
class Part:
    """Data of the study, and the factor of their one-step problem."""

    recording: Recording
    factor: Regression


@dataclass(frozen=True)
class Run:
    """One run of one method.

    Attributes:
        errors: RMS in the output's unit by part and mode; infinite after a divergence.
        curve: training error after every cycle or epoch.
        test_curve: that of a network on the test part, which it does not see.
    """

    errors: Mapping[Key, float]
    curve: FloatArray
    test_curve: FloatArray | None = None


@dataclass(frozen=True)
class Study:
    """All runs of all methods on one pair of training and test data.

    Attributes:
        runs: by method, in the order of `TITLES`.
        patterns: number of patterns by part.
        persistence: error of repeating the last sample, by part.
        unconstrained: one-step error, by part, of the coefficients that fit the training part
            best with no physics to bind them; in training no physical model is below it.
    """

    runs: Mapping[str, Sequence[Run]]
    patterns: Mapping[str, int]
    persistence: Mapping[str, float]
    unconstrained: Mapping[str, float]

    def errors(self, method: str, part: str, mode: str) -> FloatArray:
        """Errors of all runs of a method, shape (runs,)."""
        return np.array([run.errors[part, mode] for run in self.runs[method]])


def study(
    train: Recording, test: Recording, plant: Plant, constants: Mapping[str, float], runs: int,
    seed: int = 0, device: str = 'cpu', run_done: Callable[[], object] = lambda: None,
    settings: Mapping[str, Settings] = SETTINGS,
) -> Study:
    """Run every method a number of times, with the settings of [B19].

    The hybrid stands on the least-squares fit of the first run.

    Args:
        train: what is fitted.
        test: what is only predicted.
        plant: the plant.
        constants: of the rig.
        runs: of each method; run i has the seed `seed + i`.
        seed: of the first run.
        device: as in `network.train_many`.
        run_done: called after every run.
        settings: of the networks, by kind.

    Raises:
        DataError: a part is too short, constant or not finite.
    """
    parts = {'train': make_part('training', train, plant), 'test': make_part('test', test, plant)}
    seeds = range(seed, seed + runs)
    found: dict[str, list[Run]] = {method: [] for method in TITLES}

    def collect(method: str, results: Iterable[Run]) -> None:
        for run in results:
            found[method].append(run)
            run_done()

    sample_time = train.sample_time
    coefficients = coefficients_of(plant, constants, sample_time)
    fits = {}
    for method in TITLES:
        if method not in ('mlp', 'hybrid'):
            fits[method] = [fit_one_step(method, parts['train'].factor, coefficients, plant, s)
                            for s in seeds]
            models = [model_of('analytical', result.best, plant, constants, sample_time)
                      for result in fits[method]]
            collect(method, (analytical_run(result, parts, model)
                             for result, model in zip(fits[method], models, strict=True)))
    base = model_of('hybrid', fits['least_squares'][0].best, plant, constants, sample_time)
    mlp = Model(plant, constants, sample_time, kind='mlp')
    collect('mlp', network_runs(mlp, settings['mlp'], parts, seeds, device))
    collect('hybrid', network_runs(base, settings['hybrid'], parts, seeds, device))
    best = parts['train'].factor.best()
    return Study(found, {name: part.factor.patterns for name, part in parts.items()},
                 {name: persistence(part.recording, plant) for name, part in parts.items()},
                 {name: float(part.factor.rms(best)) for name, part in parts.items()})


def make_part(name: str, recording: Recording, plant: Plant) -> Part:
    """Factor the one-step problem of a part.

    Raises:
        DataError: it is too short, constant or not finite; the message names the part.
    """
    inputs = [signal.name for signal in plant.inputs]
    try:
        parts_of(recording, plant)          # refuses what is too short for a free run
        return Part(recording, regression(recording.series, plant.output.name, inputs,
                                          plant.order))
    except DataError as error:
        raise DataError(f'{name} part: {error}') from error


def model_of(
    kind: str, values: FloatArray, plant: Plant, constants: Mapping[str, float],
    sample_time: float,
) -> Model:
    """Make a model of parameters in the plant's order, shape (d,), at a sample time [s]."""
    parameters = dict(zip((p.name for p in plant.parameters), values.tolist(), strict=True))
    return Model(plant, {**constants, **parameters}, sample_time, kind=kind)


def analytical_run(
    found: SearchResult, parts: Mapping[str, Part], model: Model,
) -> Run:
    """Score the model of physical parameters on both parts."""
    return Run(scores(Analytical(model), recordings_of(parts)), found.history)


def network_runs(
    model: Model, settings: Settings, parts: Mapping[str, Part], seeds: Sequence[int],
    device: str,
) -> Iterator[Run]:
    """Train networks on the training part, on the analytical model's error if it is a hybrid."""
    problems = {name: network_problem(part.recording, model) for name, part in parts.items()}
    recordings = recordings_of(parts)
    jobs = [Job(settings, seed) for seed in seeds]
    for trained in train_many(problems['train'], jobs, device, problems['test']):
        predictor = NetworkPredictor(model, trained.network)
        yield Run(scores(predictor, recordings), trained.learning_curve,
                  trained.held_out_curve)


def recordings_of(parts: Mapping[str, Part]) -> dict[str, Recording]:
    """Take the recordings of the parts."""
    return {name: part.recording for name, part in parts.items()}


def scores(predictor: Predictor, parts: Mapping[str, Recording]) -> dict[Key, float]:
    """Score a predictor on both parts; infinite where a run diverges."""
    errors = errors_of(predictor, parts)
    return {(part, mode): error if math.isfinite(error) else math.inf
            for mode, by_part in errors.items() for part, error in by_part.items()}


def five_numbers(errors: FloatArray) -> FloatArray:
    """Minimum, quartiles and maximum, as in [B19] Tables 4 and 5; infinite errors rank last."""
    numbers = np.quantile(np.minimum(errors, HUGE), [0.0, 0.25, 0.5, 0.75, 1.0])
    return np.where(numbers > 1e-9 * HUGE, np.inf, numbers)


def mann_whitney(first: FloatArray, second: FloatArray) -> float:
    """p-value of the two-sided Mann-Whitney test, as in [B19] Tables 6 and 7."""
    if np.ptp(np.concatenate([first, second])) == 0.0:
        return 1.0                          # all equal, of which scipy makes 0/0
    return float(mannwhitneyu(first, second).pvalue)
