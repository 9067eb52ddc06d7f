"""The coefficients of a plant's difference equation, for whole populations of parameters."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy.typing as npt

from hydro_twin.fitting.one_step import Coefficients
from hydro_twin.plants import Plant
from hydro_twin.plants.difference_equation import bilinear_coefficients


def coefficients_of(
    plant: Plant, constants: Mapping[str, float], sample_time: float,
) -> Coefficients:
    """Return the map from parameters to the coefficients of y(k-1..k-n) and u(k..k-n).

    Args:
        plant: its closed form is taken where it has one, else the bilinear transform of its laws.
        constants: of the rig, by name.
        sample_time: T [s].
    """
    closed_form = plant.closed_form
    if closed_form is not None:
        return lambda population: closed_form(population, constants, sample_time)
    names = [p.name for p in plant.parameters]

    def general(population: npt.NDArray[Any]) -> npt.NDArray[Any]:
        laws = plant.laws({**constants, **dict(zip(names, population.T[..., None], strict=True))})
        return bilinear_coefficients(laws.A, laws.B, laws.C, laws.D, sample_time)

    return general
