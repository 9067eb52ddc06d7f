"""Values to begin a search at, from the one-step error of the linear plant.

Where the output stands at an end stop, or drifts, a free run is met best by a plant that does not
move at all. The one-step error asks only how it moves from one sample to the next. Noise biases
its fit, the more the less the output moves in a step, so it is also made with longer steps.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

from hydro_twin.errors import DataError
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.one_step import search_least_squares
from hydro_twin.fitting.parts import Part, thin
from hydro_twin.fitting.regression import regression
from hydro_twin.plants import Plant
from hydro_twin.recording.series import Series

STEPS = (1, 4, 16)      # samples in a step, up to those for which a slow sensor repeats a value
STARTS = 3              # points searched from: the result only begins another search
DIFFERENT = 1.5         # ratio of a parameter in two fits, from which both are worth a search


def one_step_values(plant: Plant, parts: Sequence[Part], constants: Mapping[str, float],
                    sample_time: float, seed: int = 0) -> list[dict[str, float]]:
    """Fit the parameters of a plant within their box by the one-step error, for several steps.

    Args:
        plant: the plant.
        parts: what is fitted.
        constants: of the rig.
        sample_time: of the parts [s].
        seed: of the starts.

    Returns:
        The parameters by name, of each fit that differs from those with shorter steps; none where
        the parts do not allow such a fit.
    """
    found: list[dict[str, float]] = []
    for factor in STEPS:
        values = _one_step_fit(plant, thin(parts, plant, factor), constants,
                               factor * sample_time, seed)
        if values is not None and all(_differ(values, other) for other in found):
            found.append(values)
    return found


def _differ(a: Mapping[str, float], b: Mapping[str, float]) -> bool:
    """Whether any parameter differs by so much that a search from there may end otherwise."""
    return any(abs(math.log(a[name] / b[name])) > math.log(DIFFERENT) for name in a)


def _one_step_fit(plant: Plant, parts: Sequence[Part], constants: Mapping[str, float],
                  sample_time: float, seed: int) -> dict[str, float] | None:
    inputs = [signal.name for signal in plant.inputs]
    series = [Series({plant.output.name: part.measured,
                      **dict(zip(inputs, part.inputs.T, strict=True))}, sample_time)
              for part in parts]
    try:
        factor = regression(series, plant.output.name, inputs, plant.order)
    except DataError:
        return None
    found = search_least_squares(factor, coefficients_of(plant, constants, sample_time), plant,
                                 seed, STARTS)
    return dict(zip((p.name for p in plant.parameters), found.best.tolist(), strict=True))
