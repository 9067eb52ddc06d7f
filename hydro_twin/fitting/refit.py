"""Fit of a whole model: physical parameters by any method, weights, errors on both parts."""
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Any

from hydro_twin.blas import one_thread
from hydro_twin.effects import Placed
from hydro_twin.errors import DataError, UserError
from hydro_twin.files import write_whole
from hydro_twin.fitting.estimates import fitted_model
from hydro_twin.fitting.horizon import horizon_errors
from hydro_twin.fitting.identifiability import Identifiability
from hydro_twin.fitting.network import check_device, Job, make_problem, Problem, train_batch
from hydro_twin.fitting.network_search import DECAYS, search, STRUCTURES
from hydro_twin.fitting.noise import estimate_noise
from hydro_twin.fitting.outputs import sensor_rms
from hydro_twin.fitting.physics import (
    COLOURED,
    fit_anew,
    fit_physics,
    method_named,
    Physics,
    Task,
)
from hydro_twin.fitting.regression import factored, regression
from hydro_twin.model import Model, Record, write_model
from hydro_twin.plants import Plant
from hydro_twin.predictors import Kind, kind_named, kinds, make_predictor, Predictor
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.kind import Fitted, Settings
from hydro_twin.predictors.network import network_bytes
from hydro_twin.predictors.network_predictor import NetworkPredictor
from hydro_twin.predictors.scores import Errors, errors_of, persistence, predict
from hydro_twin.progress import Progress, silent
from hydro_twin.recording.series import Recording

WEIGHTS = '.safetensors'    # ending of the file of weights


@dataclass(frozen=True)
class Request:
    """What to fit, and how.

    Attributes:
        predictor: name of a kind of predictor.
        method: name of a method for the physical parameters.
        criterion: 'one_step' or 'free_run', the error to minimise; None: free_run for an
            analytical model by least squares, else one_step.
        held: parameters taken as known, by name, in SI units.
        effects: known ones, which the model is to have.
        base: an analytical model, with its effects, that is fitted anew; or on which the weights
            of a hybrid stand, as it is.
        hidden: widths of the hidden layers; None: those of the kind.
        decay: weight decay; None: that of the kind.
        epochs: of training.
        search: file for the trials of a search for what `hidden` and `decay` leave open; None:
            no search.
        device: a torch device, 'cpu' or 'cuda'.
        seed: of all that is random.
    """

    predictor: str = 'analytical'
    method: str = 'least_squares'
    criterion: str | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[Placed, ...] = ()
    base: Model | None = None
    hidden: tuple[int, ...] | None = None
    decay: float | None = None
    epochs: int = 500
    search: Path | None = None
    device: str = 'cpu'
    seed: int = 0

    @property
    def kind(self) -> Kind:
        """The kind of predictor."""
        return kind_named(self.predictor)

    def check(self, effects: bool = False, base: bool = False) -> None:
        """Refuse what does not go together.

        Args:
            effects: whether known ones are still to come.
            base: whether a model to stand on is still to come.

        Raises:
            UserError: a setting is for another kind of predictor, or none there is.
            ModuleNotFoundError: torch is needed and not installed.
        """
        kind, effects = self.kind, bool(self.effects) or effects
        method_named(self.method)
        if self.epochs < 1:
            raise UserError(f'--epochs {self.epochs}: at least one is needed')
        if kind.network:
            check_device(self.device)
        elif self.hidden or self.search or self.decay is not None:
            raise UserError('--hidden, --decay and --search are for networks: --predictor '
                            + names_of(lambda kind: kind.network is not None))
        if kind.network and kind.network.recurrent and (
                self.search or len(self.hidden or (1,)) > 1):
            layered = names_of(lambda kind: bool(kind.network and not kind.network.recurrent),
                               'and')
            raise UserError(f'{kind.title} has one hidden layer, and --search is for {layered}')
        if not kind.physics and (self.criterion or self.method != 'least_squares' or self.held
                                 or effects):
            raise UserError('--method, --criterion, --fix and known effects are for '
                            f'physical parameters; {kind.title} has none')
        if self.base is None and not base:
            return
        if not kind.physics:
            raise UserError(f'--model gives the physics; {kind.title} has none')
        if (self.held or effects or self.method != 'least_squares'
                or self.criterion == 'one_step'):
            raise UserError('--method, --criterion one_step, --fix and known effects are for a '
                            'fresh fit; --model has its own')
        if self.base and not kind_named(self.base.kind).physics:
            raise UserError(f'--model is of kind {self.base.kind}, without the physics that '
                            f'{kind.title} stands on')
        if self.base and kind.analytical and self.base.kind != kind.name:
            raise UserError(f'--model is of kind {self.base.kind}, whose weights were trained on '
                            'its physics: only an analytical model is fitted anew')


@dataclass(frozen=True)
class Refit:
    """A model as fitted.

    Attributes:
        model: with its errors; the name of its weights is given when it is saved.
        predictor: runs it.
        weights: content of its .safetensors file; None without one.
        known: what the data determine; None where the method cannot say.
        settings: of its network; None without one.
        outputs: of each sensor that was fitted, and of the output with them, the RMS error of the
            free run by part, and the noise estimated with the fit, in its unit.
        references: 'persistence' and 'unconstrained' -> part -> the RMS one-step error that
            a fit is compared with, in the output's unit; see `reference_errors`.
    """

    model: Model
    predictor: Predictor
    weights: bytes | None
    known: Identifiability | None
    settings: Settings | None
    references: Errors
    outputs: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def save(self, path: Path | str) -> None:
        """Write the model file, and its weights beside it, each atomically.

        Raises:
            UserError: a model file must not have that name.
            ModelError: the model file cannot be written there.
            OSError: its weights cannot.
        """
        path, model = Path(path), self.model
        check_name(path)
        if self.weights is not None:
            weights = companion(path, WEIGHTS)
            write_whole(weights, self.weights)
            model = replace(model, network=weights.name)
        write_model(model, path)

    def summary(self) -> dict[str, Any]:
        """Return parameters, settings and errors as `refit --json` prints them."""
        model = self.model
        units = {p.name: p.unit for p in model.plant.parameters}
        errors = model.errors['after']
        return {
            'unit': model.plant.output.unit,
            'sample_time': model.sample_time,
            'parameters': {name: {'value': e.value, 'unit': units[name],
                                  'std_error': e.std_error, 'identifiable': e.identifiable,
                                  'held': e.held, 'at_bound': e.at_bound or None}
                           for name, e in model.parameters.items()},
            'effects': [{'id': placed.effect.id, 'port': placed.port.name, 'parameters': {
                p.name: {'value': value, 'unit': placed.effect.unit(p, placed.port),
                         'std_error': model.record.std_error(k, p.name),
                         'held': f'{k}:{p.name}' not in model.record.uncertainty}
                for p, value in placed.in_use}}
                for k, placed in enumerate(model.effects)],
            'hidden': list(self.settings.hidden) if self.settings else [],
            'decay': self.settings.decay if self.settings else None,
            'at_bound': [name for name, e in model.parameters.items() if e.at_bound],
            'notes': list(model.record.notes),
            'combinations': dict(self.known.combinations) if self.known else {},
            'outputs': {name: dict(figures) for name, figures in self.outputs.items()},
            **{part: {mode: parts[part] for mode, parts in errors.items()}
               for part in ('train', 'test')},
            **self.references,
        }


@one_thread()
def refit(train: Recording, test: Recording, plant: Plant, constants: Mapping[str, float],
          request: Request, provenance: Mapping[str, Any], show: Progress = silent) -> Refit:
    """Fit a model to a recording, and score it on both parts.

    Args:
        train: what is fitted.
        test: what is only predicted.
        plant: the plant.
        constants: of the rig, in SI units.
        request: what to fit.
        provenance: what the model file is to say of where it comes from.
        show: shows what is being done.

    Raises:
        UserError: the request does not go together.
        DataError: the samples do not allow it.
        ModuleNotFoundError: torch is needed and not installed.
    """
    request.check()
    plant.holding(request.held)
    kind, known = request.kind, None
    left: Mapping[str, float] = {}
    references = reference_errors(train, test, plant)
    model = Model(plant, constants, train.sample_time, request.effects, kind=kind.name,
                  record=Record(provenance=provenance))
    if request.base is not None and kind.analytical:
        with show('fitting the physics', None):
            fit = fit_anew(request.base, train)
        known, left = fit.identifiability(), fit.noise
        model = replace(fitted_model(fit, known, {}), plant=plant).with_record(
            notes=(COLOURED,) if fit.whitened else (),
            provenance={**provenance, 'method': request.method, 'criterion': 'free_run'})
    elif request.base is not None:
        physics = replace(request.base, kind='analytical', network=None).at(model.sample_time)
        model = replace(physics, kind=kind.name, noise=None).with_record(provenance=provenance)
    elif kind.physics:
        with show('fitting the physics', None):
            found, criterion = _physics(train, model, request)
        known, left = found.known, found.noise
        model = replace(
            model, values={**constants, **found.values}, record=Record(
                found.uncertainty, notes=found.notes, provenance={
                    **provenance, 'method': request.method, 'criterion': criterion}))
    settings, fitted = None, None
    if kind.network:
        settings, fitted = _network(train, model, request, kind.network, show)
    elif kind.fit:
        with show('fitting the weights', None):
            fitted = kind.fit(train, model, request.seed)
    if kind.analytical:
        with show('estimating the noise', None):
            model = replace(model, noise=estimate_noise(model, train.series))
    predictor = fitted.predictor if fitted else make_predictor(model, Path())
    parts = {'train': train, 'test': test}
    errors = errors_of(predictor, parts)
    if plant.integrates:
        errors |= horizon_errors(model, parts)
    outputs: dict[str, dict[str, float]] = {}
    if isinstance(predictor, Analytical):
        by_output = {plant.output.name: errors['free_run']} | sensor_rms(predictor, parts)
        outputs = {name: {**by_output.get(name, {}), 'noise': noise}
                   for name, noise in left.items()}
    return Refit(model.with_record(errors={'after': errors}), predictor,
                 fitted.weights if fitted else None, known, settings, references, outputs)


def check_name(path: Path) -> None:
    """Refuse a model file that its own weights would overwrite.

    Raises:
        UserError: it is named as weights are.
    """
    if path.suffix == WEIGHTS:
        raise UserError(f'{path}: {WEIGHTS} is for the weights beside a model file; name it '
                        f'{path.with_suffix(".yaml")}')


def companion(path: Path, ending: str) -> Path:
    """Name a file beside a model file; models of different names have different ones."""
    return path.with_name(path.name.removesuffix('.yaml') + ending)


def names_of(has: Callable[[Kind], bool], last: str = 'or') -> str:
    """List the kinds of predictor that have something: 'gru, hybrid or mlp'."""
    *names, end = [kind.name for kind in kinds().values() if has(kind)]
    return f'{", ".join(names)} {last} {end}' if names else end


def _physics(train: Recording, model: Model, request: Request) -> tuple[Physics, str]:
    """Fit the physical parameters; returns the criterion too."""
    criterion = request.criterion or (
        'free_run' if request.kind.analytical and request.method == 'least_squares'
        else 'one_step')
    return fit_physics(Task(train, model.plant, model.constants, criterion, request.seed,
                            request.held, model.effects), request.method), criterion


def _network(train: Recording, model: Model, request: Request, settings: Settings,
             show: Progress) -> tuple[Settings, Fitted]:
    """Train the network of a model, of the settings asked for or found."""
    problem = network_problem(train, model)
    settings = replace(settings, epochs=request.epochs, hidden=request.hidden or settings.hidden,
                       decay=settings.decay if request.decay is None else request.decay)
    if request.search:
        with show('searching the settings', None) as tick:
            rounds = search(problem, settings, request.search, request.seed, request.device,
                            DECAYS if request.decay is None else (settings.decay,),
                            (settings.hidden,) if request.hidden else STRUCTURES,
                            trial_done=tick)
        settings = rounds[-1].chosen
    with show('training the network', request.epochs) as tick:
        trained = train_batch(problem, [Job(settings, request.seed)], request.device, tick)[0]
    return settings, Fitted(NetworkPredictor(model, trained.network),
                            network_bytes(trained.network))


def network_problem(train: Recording, model: Model) -> Problem:
    """Collect what the network of a model is to learn.

    Raises:
        DataError: the samples do not allow it.
    """
    predicted = None
    if kind_named(model.kind).physics:
        predicted = predict(Analytical(model), train.series, 'one_step')
    return make_problem(train.series, model.plant, predicted)


def reference_errors(train: Recording, test: Recording, plant: Plant) -> Errors:
    """Return the one-step errors that a fit is compared with.

    Returns:
        'persistence': of repeating the last sample; 'unconstrained': of the linear difference
        equation fitted to the training part without physics; nan where a part has no pattern.

    Raises:
        DataError: a sample is not finite, or the training part cannot be fitted. The test part is
            only predicted: it may be short, or at rest.
    """
    inputs = [signal.name for signal in plant.inputs]
    try:
        factor = regression(train.series, plant.output.name, inputs, plant.order)
    except DataError as error:
        raise DataError(f'the training part: {error}') from None
    held_out, *_ = factored(test.series, plant.output.name, inputs, plant.order)
    best = factor.best()
    return {
        'persistence': {'train': persistence(train, plant), 'test': persistence(test, plant)},
        'unconstrained': {'train': float(factor.rms(best)),
                          'test': float(held_out.rms(best)) if held_out else math.nan},
    }
