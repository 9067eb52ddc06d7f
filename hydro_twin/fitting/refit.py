"""Fit of a whole model: physical parameters by any method, networks, errors on both parts."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.errors import UserError
from hydro_twin.fitting.candidate import parts_of
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.free_run import fit_linear
from hydro_twin.fitting.identifiability import assess, Identifiability
from hydro_twin.fitting.network import make_problem, Problem
from hydro_twin.fitting.one_step import at_bound, sensitivities
from hydro_twin.fitting.populations import fit_one_step
from hydro_twin.fitting.populations import METHODS as POPULATIONS
from hydro_twin.fitting.regression import regression
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.model import Estimate, Model
from hydro_twin.plants import Plant
from hydro_twin.plants.plant import Parameter
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import Errors, persistence, predict
from hydro_twin.recording.series import Recording

CRITERIA = ('free_run', 'one_step')
METHODS = ('least_squares', *POPULATIONS)
BIASED = ('one-step fit with a residual that is not white: noise of the measured outputs among '
          'the regressors biases the values by an unknown amount, so none has a standard error; '
          'a least-squares fit of the free run is free of this bias')


@dataclass(frozen=True)
class Physics:
    """Physical parameters as fitted.

    Attributes:
        known: what the data determine; None where the method cannot tell.
        notes: what must be said beside the values.
    """

    estimates: Mapping[str, Estimate]
    known: Identifiability | None
    notes: tuple[str, ...] = ()


def fit_physics(train: Recording, plant: Plant, constants: Mapping[str, float], method: str,
                criterion: str, seed: int, held: Mapping[str, float] | None = None,
                effects: tuple[Placed, ...] = ()) -> Physics:
    """Fit the parameters of the plant within the search box.

    Args:
        train: the recording to fit.
        plant: the plant.
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
    biased = False
    held = held or {}
    free = plant.holding(held)
    constants = {**constants, **held}
    if method == 'least_squares' and criterion == 'free_run':
        fit = fit_linear(free, parts_of(train, free), constants, train.sample_time, 'box',
                         timing=False, seed=seed, effects=effects)
        known = fit.identifiability()
        values = {p.name: fit.candidate.values[p.name] for p in free.parameters}
    elif criterion == 'one_step':
        names = [p.name for p in free.parameters]
        inputs = [signal.name for signal in plant.inputs]
        coefficients = coefficients_of(free, constants, train.sample_time)
        factor = regression(train.series, plant.output.name, inputs, plant.order)
        best = fit_one_step(method, factor, coefficients, free, seed).best
        lower, upper = np.array([(p.lower, p.upper) for p in free.parameters]).T
        slopes = list(sensitivities(train.series, plant.output.name, inputs, plant.order,
                                    coefficients, best))
        known = assess(slopes, names, free.combinations, at_bound(names, best, lower, upper))
        biased = not is_white([residual for _, residual in slopes])
        values = dict(zip(names, best.tolist(), strict=True))
    else:
        raise UserError(f'--method {method} minimises the one-step error, as in [B19]; '
                        'only least_squares knows --criterion free_run')
    estimates = {p.name: _estimate(p, values[p.name], known, biased) for p in free.parameters}
    notes = [f'{p.name} ended at the {estimates[p.name].at_bound} bound of its search, '
             f'{estimates[p.name].value:g} {p.unit}: not an estimate, and what is said of the '
             f'others holds for this value' for p in free.parameters
             if estimates[p.name].at_bound]
    if biased:
        known = replace(known, combinations=dict.fromkeys(known.combinations))
        notes.append(BIASED)
    estimates |= held_estimates(held)
    return Physics({p.name: estimates[p.name] for p in plant.parameters}, known, tuple(notes))


def held_estimates(held: Mapping[str, float]) -> dict[str, Estimate]:
    """Say of parameters that they were taken as known."""
    return {name: Estimate(value, identifiable=False, held=True) for name, value in held.items()}


def _estimate(p: Parameter, value: float, known: Identifiability, biased: bool) -> Estimate:
    """Say what is known of a parameter; no standard error where the fit is biased."""
    relative = known.std_error[p.name]
    edge = ''
    if p.name in known.at_bound:
        edge = 'lower' if value * value < p.lower * p.upper else 'upper'
    return Estimate(float(value),
                    None if relative is None or biased else float(value * relative),
                    relative is not None, edge)


def network_problem(train: Recording, model: Model) -> Problem:
    """Collect what the network of a model is to learn.

    Raises:
        DataError: the samples do not allow it.
    """
    predicted = None
    if model.kind == 'hybrid':
        analytical = Analytical(model)
        predicted = predict(analytical, train.series, 'one_step')
    return make_problem(train.series, model.plant, predicted)


def bounds_of(train: Recording, test: Recording, plant: Plant) -> Errors:
    """Return the errors between which any one-step fit must lie.

    Returns:
        'persistence': of repeating the last sample; 'unconstrained': of the difference equation
        that fits the training part best with no physics to bind it.
    """
    inputs = [signal.name for signal in plant.inputs]
    parts = {'train': train, 'test': test}
    factors = {name: regression(part.series, plant.output.name, inputs, plant.order)
               for name, part in parts.items()}
    best = factors['train'].best()
    return {
        'persistence': {name: persistence(part, plant) for name, part in parts.items()},
        'unconstrained': {name: float(factor.rms(best)) for name, factor in factors.items()},
    }
