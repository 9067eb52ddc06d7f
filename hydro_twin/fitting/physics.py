"""Fit of the physical parameters of a plant: what a method is given, and what it returns."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

from hydro_twin.effects import Placed
from hydro_twin.errors import UserError
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.coloured import with_coloured_noise
from hydro_twin.fitting.estimates import edge
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import horizon_windows, moving_windows
from hydro_twin.fitting.identifiability import assess, Identifiability
from hydro_twin.fitting.linear import beyond_the_box, fit_linear, refuse_reversed
from hydro_twin.fitting.one_step import (
    at_bound,
    box,
    Coefficients,
    search_least_squares,
    SearchResult,
    sensitivities,
)
from hydro_twin.fitting.outputs import sensors_in
from hydro_twin.fitting.parts import parts_of, with_travel
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.regression import Regression, regression
from hydro_twin.fitting.unknowns import unknowns_of
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.model import Model, Record, Uncertainty
from hydro_twin.plants import Plant
from hydro_twin.plants.plant import Parameter
from hydro_twin.plugins import plugin_named, plugin_names
from hydro_twin.recording.series import Recording

CRITERIA = ('free_run', 'one_step')
GROUP = 'hydro_twin.methods'    # entry points: the studies' methods and those of other packages
BIASED = ('one-step fit with a residual that is not white: noise of the measured outputs among '
          'the regressors biases the values by an unknown amount, so none has a standard error; '
          'a least-squares fit of the free run is free of this bias')
COLOURED = ('what is left is coloured noise: it was fitted by its likelihood as an autoregressive '
            'process, and the standard errors are those of that fit')
STANDING = ('the output stands at an end of its travel in {:.0%} of the samples, where a stop may '
            'hold it: these were left out of the fit')

# (one-step problem, coefficients of parameters, plant with a search box, seed) -> the best
Search = Callable[[Regression, Coefficients, Plant, int], SearchResult]


@dataclass(frozen=True)
class Task:
    """What a method is asked to fit.

    Attributes:
        train: the recording to fit.
        constants: of the rig, in SI units.
        criterion: one of CRITERIA: the error to minimise.
        seed: of all that is random.
        held: parameters taken as known, by name, in SI units.
        effects: known ones; the free run has them, one step is of the linear laws.
    """

    train: Recording
    plant: Plant
    constants: Mapping[str, float]
    criterion: str
    seed: int
    held: Mapping[str, float]
    effects: tuple[Placed, ...] = ()


@dataclass(frozen=True)
class Physics:
    """Physical parameters as fitted.

    Attributes:
        known: what the data determine; None where the method cannot say.
        notes: what must be said beside the values.
        noise: RMS of what is left of output and sensors, each in its unit, where that was fitted.
    """

    values: Mapping[str, float]
    uncertainty: Mapping[str, Uncertainty]
    known: Identifiability | None
    notes: tuple[str, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Method:
    """A way to fit physical parameters.

    Attributes:
        name: after `--method`.
        fit: does it; raises UserError where the task is not for it, DataError where the samples
            do not allow it.
        criteria: those of CRITERIA that it can minimise.
    """

    name: str
    fit: Callable[[Task], Physics]
    criteria: tuple[str, ...] = ('one_step',)


def method_named(name: str) -> Method:
    """Return the method of that name.

    Raises:
        UserError: there is none, the message lists those there are; or it cannot be loaded.
    """
    if name == LEAST_SQUARES.name:
        return LEAST_SQUARES
    if name not in plugin_names(GROUP):
        known = ', '.join((LEAST_SQUARES.name, *plugin_names(GROUP)))
        raise UserError(f'no method {name!r}; there are {known}')
    return plugin_named(GROUP, name, Method)


def fit_physics(task: Task, method: str) -> Physics:
    """Fit the parameters of the plant within the search box, by the method of that name.

    Raises:
        UserError: there is no such method or criterion, the method knows another criterion only,
            or a held parameter is not one.
        DataError: the samples do not allow it.
    """
    chosen = method_named(method)
    if task.criterion not in CRITERIA:
        raise UserError(f'no criterion {task.criterion!r}; there are {", ".join(CRITERIA)}')
    if task.criterion not in chosen.criteria:
        raise UserError(f'--method {method} minimises the one-step error, as in [B19]; '
                        'only least_squares knows --criterion free_run')
    return chosen.fit(task)


def fit_free_run(task: Task) -> Physics:
    """Fit the output error by least squares."""
    free, sample_time = task.plant.holding(task.held), task.train.sample_time
    parts, left_out = parts_of(task.train, free), 0.0
    free = free.seen_by(sensors_in(parts, free, free.start_samples(sample_time)))
    if free.integrates:
        parts, left_out = moving_windows(parts, free, sample_time)
    fit = fit_linear(free, parts, {**task.constants, **task.held}, sample_time,
                     seed=task.seed, effects=task.effects)
    fit = beyond_the_box(fit, parts)
    refuse_reversed(fit, parts)
    fit = with_coloured_noise(fit, parts)
    values = {p.name: fit.candidate.values[p.name] for p in free.parameters}
    found = replace(_physics(task, free, values, fit.identifiability(), biased=False),
                    noise=fit.noise)
    notes = [COLOURED] if fit.whitened else []
    notes += [STANDING.format(left_out)] if left_out else []
    return replace(found, notes=(*found.notes, *notes))


def fit_anew(model: Model, train: Recording) -> Fit:
    """Fit the output error of an analytical model with its effects, from its present values.

    All parameters, timing and effects are fitted; none is added or taken off.

    Raises:
        DataError: the samples do not allow it.
    """
    start = replace(model.at(train.sample_time), noise=None, record=Record())
    (parts,) = with_travel(parts_of(train, start.plant))
    plant = start.plant.seen_by(sensors_in(parts, start.plant, start.start_up))
    if plant.integrates:
        parts = horizon_windows(parts, plant, train.sample_time)
    start = replace(start, plant=plant)
    return with_coloured_noise(Problem(start, unknowns_of(start), parts).solve(), parts)


def fit_one_step(task: Task, search: Search) -> Physics:
    """Fit the one-step prediction error by a search of the box."""
    plant, train = task.plant, task.train
    free = plant.holding(task.held)
    names = [p.name for p in free.parameters]
    inputs = [signal.name for signal in plant.inputs]
    coefficients = coefficients_of(free, {**task.constants, **task.held}, train.sample_time)
    factor = regression(train.series, plant.output.name, inputs, plant.order)
    best = search(factor, coefficients, free, task.seed).best
    lower, upper = box(free)
    slopes = list(sensitivities(train.series, plant.output.name, inputs, plant.order,
                                coefficients, best))
    known = assess(slopes, names, free.combinations, at_bound(names, best, lower, upper))
    return _physics(task, free, dict(zip(names, best.tolist(), strict=True)), known,
                    biased=not is_white([residual for _, residual in slopes]))


def _fit_least_squares(task: Task) -> Physics:
    if task.criterion == 'free_run':
        return fit_free_run(task)
    return fit_one_step(task, search_least_squares)


LEAST_SQUARES = Method('least_squares', _fit_least_squares, CRITERIA)


def _physics(task: Task, free: Plant, values: Mapping[str, float], known: Identifiability,
             biased: bool) -> Physics:
    """Say of values what is known of them."""
    uncertainty = {p.name: _uncertainty(p, values[p.name], known, biased)
                   for p in free.parameters} | as_known(task.held)
    notes = [f'{p.name} ended at the {uncertainty[p.name].at_bound} bound of its search, '
             f'{values[p.name]:g} {p.unit}: not an estimate, and what is said of the '
             f'others holds for this value' for p in free.parameters
             if uncertainty[p.name].at_bound]
    if biased:
        known = replace(known, combinations=dict.fromkeys(known.combinations))
        notes.append(BIASED)
    every = {**values, **task.held}
    return Physics({p.name: every[p.name] for p in task.plant.parameters}, uncertainty, known,
                   tuple(notes))


def as_known(names: Iterable[str]) -> dict[str, Uncertainty]:
    """Say of parameters that they were taken as known."""
    return {name: Uncertainty(identifiable=False, held=True) for name in names}


def _uncertainty(p: Parameter, value: float, known: Identifiability, biased: bool
                 ) -> Uncertainty:
    """Say what is known of a parameter; no standard error where the fit is biased."""
    relative = known.std_error[p.name]
    return Uncertainty(
        std_error=None if relative is None or biased else float(value * relative),
        identifiable=relative is not None,
        at_bound=edge(value, p.lower, p.upper) if p.name in known.at_bound else '')
