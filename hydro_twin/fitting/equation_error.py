"""Values to begin a search at, from the one-step error of the linear plant.

Where the output stands at an end stop, or drifts, a free run is met best by a plant that does not
move at all. The one-step error is biased by noise, but asks only how it moves from one sample to
the next.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydro_twin.errors import DataError
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.one_step import least_squares
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.regression import regression
from hydro_twin.plants import Plant
from hydro_twin.recording.series import Series


def one_step_values(plant: Plant, parts: Sequence[Part], constants: Mapping[str, float],
                    sample_time: float, seed: int = 0) -> dict[str, float] | None:
    """Fit the parameters of a plant within their box by the one-step error.

    Args:
        plant: the plant.
        parts: what is fitted.
        constants: of the rig.
        sample_time: of the parts [s].
        seed: of the starts.

    Returns:
        The parameters by name; None where the parts do not allow such a fit.
    """
    inputs = [signal.name for signal in plant.inputs]
    series = [Series({plant.output.name: part.measured,
                      **dict(zip(inputs, part.inputs.T, strict=True))}, sample_time)
              for part in parts]
    try:
        factor = regression(series, plant.output.name, inputs, plant.order)
    except DataError:
        return None
    lower, upper = np.array([(p.lower, p.upper) for p in plant.parameters]).T
    names = [p.name for p in plant.parameters]
    found = least_squares(factor, coefficients_of(plant, constants, sample_time), names,
                          plant.combinations, lower, upper, seed)
    return dict(zip(names, found.best.tolist(), strict=True))
