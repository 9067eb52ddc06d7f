"""Fit of a whole model: physical parameters by any method, networks, errors on both parts."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.errors import UserError
from hydro_twin.fitting.candidate import parts_of
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.free_run import fit_linear
from hydro_twin.fitting.identifiability import assess, Identifiability
from hydro_twin.fitting.network import make_problem, Problem
from hydro_twin.fitting.one_step import at_bound, sensitivities
from hydro_twin.fitting.populations import METHODS as POPULATIONS
from hydro_twin.fitting.regression import regression
from hydro_twin.fitting.start import START
from hydro_twin.fitting.study import fit as search
from hydro_twin.model import Estimate, Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.predictor import Predictor
from hydro_twin.predictors.scores import pooled, rms
from hydro_twin.recording.series import Recording

CRITERIA = ('free_run', 'one_step')
METHODS = ('least_squares', *POPULATIONS)

Errors = dict[str, dict[str, float]]        # mode -> part -> RMS error, in the output's unit


@dataclass(frozen=True)
class Physics:
    """Physical parameters as fitted.

    Attributes:
        known: what the data determine; None where the method cannot tell.
    """

    estimates: Mapping[str, Estimate]
    known: Identifiability | None


def fit_physics(train: Recording, plant: Plant, constants: Mapping[str, float], method: str,
                criterion: str, seed: int, held: Mapping[str, float] | None = None,
                effects: tuple[Placed, ...] = ()) -> Physics:
    """Fit the parameters of the plant within the search box.

    Args:
        train: the recording to fit.
        plant: at the sample time of the recording.
        constants: of the rig.
        method: one of METHODS.
        criterion: one of CRITERIA, for least squares; the others have theirs.
        seed: of all that is random.
        held: parameters taken as known, by name.
        effects: known ones; the free run has them, one step is of the linear laws.

    Raises:
        UserError: the method knows another criterion only, or a held parameter is not one.
        DataError: the samples do not allow it.
    """
    held = held or {}
    free = plant.holding(held)
    constants = {**constants, **held}
    if method == 'least_squares' and criterion == 'free_run':
        fit = fit_linear(free, parts_of(train, free), constants, plant.sample_time, 'box',
                         timing=False, seed=seed, effects=effects)
        known = fit.identifiability()
        values = {p.name: fit.candidate.values[p.name] for p in free.parameters}
    elif criterion == 'one_step':
        names = [p.name for p in free.parameters]
        inputs = [signal.name for signal in plant.inputs]
        coefficients = coefficients_of(free, constants, plant.sample_time)
        factor = regression(train.series, plant.output.name, inputs, plant.order)
        best = search(method, factor, coefficients, free, seed).best
        lower, upper = np.array([(p.lower, p.upper) for p in free.parameters]).T
        known = assess(sensitivities(train.series, plant.output.name, inputs, plant.order,
                                     coefficients, best),
                       names, free.combinations, at_bound(names, best, lower, upper))
        values = dict(zip(names, best.tolist(), strict=True))
    else:
        raise UserError(f'--method {method} minimises the one-step error, as in [B19]; '
                        'only least_squares knows --criterion free_run')
    estimates = {name: _estimate(value, known.std_error[name])
                 for name, value in values.items()} | held_estimates(held)
    return Physics({p.name: estimates[p.name] for p in plant.parameters}, known)


def held_estimates(held: Mapping[str, float]) -> dict[str, Estimate]:
    """Say of parameters that they were taken as known."""
    return {name: Estimate(value, identifiable=False, held=True) for name, value in held.items()}


def _estimate(value: float, relative: float | None) -> Estimate:
    """Join a value and its relative standard error, None where the data do not tell it."""
    return Estimate(float(value), None if relative is None else float(value * relative),
                    relative is not None)


def network_problem(train: Recording, model: Model) -> Problem:
    """Collect what the network of a model of kind 'mlp' or 'hybrid' is to learn.

    Raises:
        DataError: the samples do not allow it.
    """
    predicted = None
    if model.kind == 'hybrid':
        analytical = Analytical(model)
        predicted = [analytical.one_step(series) for series in train.series]
    return make_problem(train.series, model.plant, predicted)


def errors_of(predictor: Predictor, train: Recording, test: Recording) -> Errors:
    """Score a model on both parts.

    One step leaves out the order + 1 samples of each series that only feed the regressors, as
    in [B19]. A free run of an analytical model starts from the state that the first samples of
    a series show, any other at rest; neither scores these samples.
    """
    plant = predictor.plant
    errors: Errors = {'one_step': {}, 'free_run': {}}
    for name, part in (('train', train), ('test', test)):
        one_step = [predictor.one_step(series) for series in part.series]
        errors['one_step'][name] = rms(
            pooled(part, plant.output.name, one_step, plant.order + 1)[0])
        errors['free_run'][name] = _free_run_error(predictor, part)
    return errors


def _free_run_error(predictor: Predictor, part: Recording) -> float:
    from hydro_twin.fitting.candidate import Candidate

    model, plant = predictor.model, predictor.plant
    if model.kind == 'analytical':
        candidate = Candidate(plant, model.values, model.sample_time, model.placed, model.timing,
                              model.substeps)
        return rms(np.concatenate([candidate.residual(p) for p in parts_of(part, plant)]))
    free_run = [predictor.free_run(series) for series in part.series]
    return rms(pooled(part, plant.output.name, free_run, START)[0])


def bounds_of(train: Recording, test: Recording, plant: Plant) -> Errors:
    """Return the errors between which any one-step fit must lie.

    Returns:
        'persistence': of repeating the last sample; 'unconstrained': of the difference equation
        that fits the training part best with no physics to bind it.
    """
    inputs = [signal.name for signal in plant.inputs]
    factors = {name: regression(part.series, plant.output.name, inputs, plant.order)
               for name, part in (('train', train), ('test', test))}
    best = factors['train'].best()
    return {
        'persistence': {name: factor.persistence() for name, factor in factors.items()},
        'unconstrained': {name: float(factor.rms(best)) for name, factor in factors.items()},
    }
