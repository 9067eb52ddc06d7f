"""The fit of a plant's own parameters, from several starts."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.fitting.equation_error import one_step_values
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import residuals
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem, solve_all
from hydro_twin.fitting.unknowns import plant_unknowns
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.scores import rms

SUBSTEPS = 2            # steps in a sample of a search, which the last fits refine
SHORT, KEPT = 10, 2     # evaluations of the search from each start, and starts that go on
GIVEN = 4               # steps in a sample with given effects: no search refines them later


def fit_linear(plant: Plant, parts: Sequence[Part], constants: Mapping[str, float],
               sample_time: float, seed: int = 0, starts: int = 3,
               effects: tuple[Placed, ...] = ()) -> Fit:
    """Fit the parameters of a plant within its search box, from several starts; the best fit.

    The starts are the middle of the box, the best of random draws in it, and the best fit by the
    one-step error. A residual that effects have bent leads a single start astray. All are searched
    a little, and the better ones to the end (successive halving).

    Args:
        plant: the plant.
        parts: what it is fitted to.
        constants: of the rig.
        sample_time: of the parts [s].
        seed: of the draws.
        starts: how many searches are made from the box.
        effects: known ones, which stay as they are.
    """
    unknowns = plant_unknowns(plant, 'box')
    rng = np.random.default_rng(seed)
    base = Model(plant, {**constants, **plant.middle()}, sample_time, effects,
                 substeps=GIVEN if effects else SUBSTEPS)
    draws = [
        replace(base, values={**base.values, **{
            p.name: float(math.exp(rng.uniform(math.log(p.lower), math.log(p.upper))))
            for p in plant.parameters}})
        for _ in range(24)]
    some = [min(parts, key=lambda part: len(part.measured))] if len(parts) > 6 else parts

    def error(candidate: Model) -> float:
        return rms(np.nan_to_num(np.concatenate(residuals(candidate, some)), nan=1e30))

    by_one_step = [replace(base, values={**base.values, **values})
                   for values in one_step_values(plant, parts, constants, sample_time, seed)]
    tried = [base, *sorted(draws, key=error)[:starts - 1], *sorted(by_one_step, key=error)[:1]]
    fits = list(solve_all([Problem(candidate, unknowns, parts) for candidate in tried], SHORT))
    best = sorted(fits, key=lambda fit: fit.cost)[:KEPT]
    return min(solve_all([Problem(fit.candidate, unknowns, parts) for fit in best]),
               key=lambda fit: fit.cost)
