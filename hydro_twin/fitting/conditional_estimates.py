"""The unidentifiable plant parameters that the size of an effect is conditional on.

Of a combination that acts only together, as T_c / k_1, one member is fitted and the others are
held. The size of an effect between them is then known only relative to those that are held: with
T_c / k_1 fixed, doubling k_1 and the width of a dead zone behind it does not change the output.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import label, left_alone, Unknown

ROUNDING = 1e-6         # of the movement by a parameter: rounding
PARTNER = 0.1           # weight from which a parameter counts as part of a direction
SAME = 0.05             # of a movement that the effects do not follow: they make up for the rest


def conditional_on(fit: Fit, parts: Sequence[Part]) -> Mapping[str, tuple[str, ...]]:
    """Say for which parameters of the plant, as they stand, those of the effects are stated.

    Args:
        fit: a fit with effects.
        parts: what it was fitted to.

    Returns:
        `label` of an effect's parameter -> names of the plant's; those that depend on none are
        left out.
    """
    plant, own = fit.candidate.plant, [u for u in fit.unknowns if u.owner.isdecimal()]
    alone = [Unknown(p.name, '', p.minimum, p.maximum, True) for p in plant.parameters
             if p.name in left_alone(plant)]
    if not own or not alone:
        return {}
    problem = Problem(fit.candidate, [*fit.unknowns, *alone], parts)
    moved = dict(zip(map(label, problem.unknowns), problem.unsearched().jacobian.T, strict=True))
    effects = np.column_stack([moved[label(unknown)] for unknown in own])
    found: dict[str, tuple[str, ...]] = {}
    for combination in plant.combinations:
        first, *others = combination
        for name in others:
            within = moved[name] - combination[name] / combination[first] * moved[first]
            if np.linalg.norm(within) < ROUNDING * np.linalg.norm(moved[first]):
                continue
            weights = np.linalg.lstsq(effects, within)[0]
            if np.linalg.norm(within - effects @ weights) > SAME * np.linalg.norm(within):
                continue
            for unknown, weight in zip(own, weights, strict=True):
                if abs(weight) > PARTNER:
                    found[label(unknown)] = (*found.get(label(unknown), ()), name)
    return found
