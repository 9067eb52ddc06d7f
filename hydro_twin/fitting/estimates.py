"""What a fit by output error says: a model with standard errors."""
from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
import math
from typing import Any

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.identifiability import Identifiability
from hydro_twin.fitting.unknowns import get, label, Unknown
from hydro_twin.model import Estimate, Model, Record, Uncertainty
from hydro_twin.plants.combinations import product_of_powers


def fitted_model(fit: Fit, known: Identifiability, errors: Mapping[str, Any]) -> Model:
    """Make a model of a fit, with standard errors and with its errors.

    Args:
        fit: a fit of all physical parameters.
        known: what the data determine of it.
        errors: see `Record`.
    """
    plant = fit.candidate.plant
    std_errors = dict.fromkeys(p.name for p in plant.parameters) | {
        label(unknown): _std_error(fit, unknown, known.std_error.get(label(unknown)))
        for unknown in fit.unknowns}
    for combination in plant.combinations:      # its members are not known by themselves
        std_errors |= dict.fromkeys(combination)
    edges = {unknown.name: edge(get(fit.candidate, unknown), unknown.lower, unknown.upper)
             for unknown in fit.unknowns
             if unknown.owner == '' and unknown.name in known.at_bound}
    return replace(fit.candidate, record=Record(
        {name: Uncertainty(std_error=std_error, identifiable=std_error is not None,
                           at_bound=edges.get(name, ''))
         for name, std_error in std_errors.items()},
        deepcopy(dict(errors))))                # what is shared would be an alias in the file


def edge(value: float, lower: float, upper: float) -> str:
    """Say at which edge of its range a positive parameter is that is at one."""
    return 'lower' if value * value < lower * upper else 'upper'


def combination_estimates(fit: Fit, known: Identifiability) -> tuple[Estimate, ...]:
    """Estimate each of the plant's combinations."""
    return tuple(_combination_estimate(fit.candidate.values, combination, known)
                 for combination in fit.candidate.plant.combinations)


def _combination_estimate(values: Mapping[str, float], combination: Mapping[str, int],
                          known: Identifiability) -> Estimate:
    """Estimate a product of powers of parameters."""
    value = math.prod(values[name] ** power for name, power in combination.items())
    relative = known.combinations[product_of_powers(combination.items())]
    return Estimate(value, std_error=None if relative is None else relative * value,
                    identifiable=relative is not None)


def _std_error(fit: Fit, unknown: Unknown, std_error: float | None) -> float | None:
    """Take a standard error from the coordinate of an unknown to its unit."""
    if std_error is None:
        return None
    return std_error * (abs(get(fit.candidate, unknown)) if unknown.log else unknown.scale)
