"""What a fit by output error says: a model with standard errors."""
from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
import math
from typing import Any

from hydro_twin.fitting.free_run import Fit, get, label, Unknown
from hydro_twin.fitting.identifiability import Identifiability
from hydro_twin.model import Estimate, FittedEffect, Model


def fitted_model(fit: Fit, known: Identifiability, errors: Mapping[str, Any]) -> Model:
    """Make a model of a fit, with standard errors and with the errors that it promises.

    Args:
        fit: a fit of all physical parameters.
        known: what the data determine of it.
        errors: see `Model`.
    """
    candidate = fit.candidate
    spreads = {label(unknown): _std_error(fit, unknown, known.std_error.get(label(unknown)))
               for unknown in fit.unknowns}
    together = {name for combination in candidate.plant.combinations for name in combination}
    parameters = {p.name: None if p.name in together else spreads.get(p.name)
                  for p in candidate.plant.parameters}
    return Model(
        plant=candidate.plant,
        parameters={name: Estimate(candidate.values[name], spread, spread is not None)
                    for name, spread in parameters.items()},
        constants={c.name: candidate.values[c.name] for c in candidate.plant.constants},
        sample_time=candidate.sample_time,
        effects=tuple(FittedEffect(placed, {p.name: spreads.get(f'{index}:{p.name}')
                                            for p in placed.effect.parameters})
                      for index, placed in enumerate(candidate.effects)),
        timing=dict(candidate.timing or {}), substeps=candidate.substeps,
        errors=deepcopy(dict(errors)))          # what is shared would be an alias in the file


def combination_estimates(fit: Fit, known: Identifiability) -> tuple[Estimate, ...]:
    """Estimate each of the plant's combinations; its first parameter was searched for all."""
    return tuple(_together(fit.candidate.values, combination, known)
                 for combination in fit.candidate.plant.combinations)


def _together(values: Mapping[str, float], combination: Mapping[str, int],
              known: Identifiability) -> Estimate:
    value = math.prod(values[name] ** power for name, power in combination.items())
    relative = known.std_error.get(next(iter(combination)))
    return Estimate(value, None if relative is None else relative * value, relative is not None)


def _std_error(fit: Fit, unknown: Unknown, spread: float | None) -> float | None:
    """Take a standard error from the coordinate of an unknown to its unit."""
    if spread is None:
        return None
    return spread * (abs(get(fit.candidate, unknown)) if unknown.log else unknown.scale)
