"""Fit of a whole model: physical parameters by any method, networks, errors on both parts."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hydro_twin.errors import DataError, UserError
from hydro_twin.fitting.candidate import parts_of
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.free_run import fit_linear
from hydro_twin.fitting.identifiability import assess, Identifiability
from hydro_twin.fitting.network import make_problem, Problem
from hydro_twin.fitting.one_step import at_bound, sensitivities
from hydro_twin.fitting.populations import fit_one_step
from hydro_twin.fitting.populations import METHODS as POPULATIONS
from hydro_twin.fitting.regression import regression
from hydro_twin.fitting.start import START
from hydro_twin.model import Estimate, Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.predictor import Predictor
from hydro_twin.predictors.scores import pooled, rms
from hydro_twin.recording.series import Recording

CRITERIA = ('free_run', 'one_step')
METHODS = ('least_squares', *POPULATIONS, 'network')

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
                criterion: str, seed: int) -> Physics:
    """Fit the parameters of the plant without effects, within the search box.

    Args:
        train: the recording to fit.
        plant: at the sample time of the recording.
        constants: of the rig.
        method: one of METHODS.
        criterion: one of CRITERIA, for least squares; the others have theirs.
        seed: of all that is random.

    Raises:
        UserError: the method is not for this plant, or knows another criterion only.
        DataError: the samples do not allow it.
    """
    if method == 'network':
        return _published(train, plant, seed)
    if method == 'least_squares' and criterion == 'free_run':
        fit = fit_linear(plant, parts_of(train, plant), constants, plant.sample_time, 'box',
                         timing=False, seed=seed)
        known = fit.identifiability()
        values = {p.name: fit.candidate.values[p.name] for p in plant.parameters}
    elif criterion == 'one_step':
        names = [p.name for p in plant.parameters]
        inputs = [signal.name for signal in plant.inputs]
        coefficients = coefficients_of(plant, constants, plant.sample_time)
        factor = regression(train.series, plant.output.name, inputs, plant.order)
        best = fit_one_step(method, factor, coefficients, plant, seed).best
        lower, upper = np.array([(p.lower, p.upper) for p in plant.parameters]).T
        known = assess(sensitivities(train.series, plant.output.name, inputs, plant.order,
                                     coefficients, best),
                       names, plant.combinations, at_bound(names, best, lower, upper))
        values = dict(zip(names, best.tolist(), strict=True))
    else:
        raise UserError(f'--method {method} minimises the one-step error, as in [B19]; '
                        'only least_squares knows --criterion free_run')
    return Physics({name: _estimate(value, known.std_error[name])
                    for name, value in values.items()}, known)


def _estimate(value: float, relative: float | None) -> Estimate:
    """Join a value and its relative standard error, None where the data do not tell it."""
    return Estimate(float(value), None if relative is None else float(value * relative),
                    relative is not None)


def _published(train: Recording, plant: Plant, seed: int) -> Physics:
    """Fit the valve servo by the network method of [L18]."""
    from hydro_twin.valve.linear_loop import PUBLISHED
    from hydro_twin.valve.published_method import fit_published

    if plant.name != 'valve_servo':
        raise UserError(f'--method network is that of [L18] for the valve_servo, '
                        f'not for {plant.name}')
    found = fit_published(train, PUBLISHED.k_1, seed).exact
    if isinstance(found, str):
        raise DataError(f'{found}; --method least_squares fits the parameters themselves')
    fastest = {p.name: p.lower for p in plant.parameters}       # for a lag that is too fast to see
    return Physics({name: Estimate(fastest[name], None, False) if np.isnan(value)
                    else Estimate(value) for name, value in found._asdict().items()}, None)


def network_problem(train: Recording, model: Model) -> Problem:
    """Collect what the network of a model is to learn.

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
