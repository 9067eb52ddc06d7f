"""The fit of a plant's own parameters, from several starts."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
import math

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.errors import DataError
from hydro_twin.fitting.equation_error import one_step_values
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import free_run_error
from hydro_twin.fitting.parts import movement, Part
from hydro_twin.fitting.problem import Problem, solve_all
from hydro_twin.fitting.unknowns import plant_unknowns
from hydro_twin.model import Model
from hydro_twin.plants import Plant

SUBSTEPS = 2            # steps in a sample of a search, which the last fits refine
DRAWS, FEW = 24, 6      # of the box; parts from which on one, the shortest, ranks them
SHORT, KEPT = 10, 2     # evaluations of the search from each start, and starts that go on
LITTLE = 0.5            # mean square that a fit of the right sign leaves, over the movement's
REVERSED = 0.1          # mean square that the right sign leaves, over that of the wrong one: a
#                         seventh and more if a controller acts against disturbances
OUTSIDE = 0.99          # error over that within the box, below which parameters leave it: less
#                         is gained by those that the data hardly determine
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
        for _ in range(DRAWS)]
    some = [min(parts, key=lambda part: len(part.measured))] if len(parts) > FEW else parts

    error = partial(free_run_error, parts=some)
    by_one_step = [replace(base, values={**base.values, **values})
                   for values in one_step_values(plant, parts, constants, sample_time, seed)]
    tried = [base, *sorted(draws, key=error)[:starts - 1], *sorted(by_one_step, key=error)[:1]]
    fits = list(solve_all([Problem(candidate, unknowns, parts) for candidate in tried], SHORT))
    best = sorted(fits, key=lambda fit: fit.cost)[:KEPT]
    return min(solve_all([Problem(fit.candidate, unknowns, parts) for fit in best]),
               key=lambda fit: fit.cost)


def beyond_the_box(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Go on within the physical ranges where a fit ended at an edge of the search box.

    The box says where to begin. What the data determine outside it is the rig's; where little is
    gained there, the fit within the box stands.

    Args:
        fit: of the plant, see `fit_linear`.
        parts: what it was fitted to.
    """
    if not fit.at_bound():
        return fit
    plant = fit.candidate.plant
    unknowns = plant_unknowns(plant, 'range', fit.candidate.sample_time)
    (wider,) = solve_all([Problem(fit.candidate, unknowns, parts)])
    return wider if wider.error < OUTSIDE * fit.error else fit


def refuse_reversed(fit: Fit, parts: Sequence[Part]) -> None:
    """Refuse a recording in which the output moves against the command.

    No parameter of a plant is below zero. So the best there is would be a gain of next to nothing,
    and effects that make up for the sign.

    Args:
        fit: of the linear plant.
        parts: what it was fitted to.

    Raises:
        DataError: the fit explains little, and that to the reversed command much more.
    """
    model, plant = fit.candidate, fit.candidate.plant
    if fit.error**2 < LITTLE * movement([part.measured for part in parts])**2:
        return
    command = plant.inputs[0].name
    sign = np.array([-1.0, *[1.0] * (len(plant.inputs) - 1)])
    constants = {constant.name: model.values[constant.name] for constant in plant.constants}
    other = fit_linear(plant, [replace(part, inputs=sign * part.inputs) for part in parts],
                       constants, model.sample_time, effects=model.effects)
    if other.error**2 < REVERSED * fit.error**2:
        unit = plant.output.unit
        raise DataError(
            f'{plant.output.name} moves against {command}: the linear plant leaves '
            f'{fit.error:.3g} {unit}, and {other.error:.3g} {unit} with the sign of {command} '
            'reversed; is its scale of the wrong sign?')
