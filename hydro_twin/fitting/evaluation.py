"""A run of a model over parts of a recording, with its residual and the derivatives of that."""
from __future__ import annotations

from dataclasses import dataclass

from hydro_twin.fitting.start import Start
from hydro_twin.plants.plant import FloatArray


@dataclass(frozen=True)
class Evaluation:
    """A run over all parts at some values of the unknowns, as where a search ended.

    Attributes:
        coordinates: of the unknowns, (d,).
        residual: of all parts, scored samples only, as in a `Fit`, (N,).
        slopes: rise of the output by each coordinate, (N, d).
        starts: state at the start of each part, once what explains the residual is taken off.
        weights: of the first samples of each part.
        scales: of output and sensors, (1 + K,).
        pulled: what leaving the usual values costs, to be squared, (2 d,).
        reason: of stopping.
    """

    coordinates: FloatArray
    residual: FloatArray
    slopes: FloatArray
    starts: tuple[Start, ...]
    weights: tuple[float, ...]
    scales: FloatArray
    pulled: FloatArray
    reason: str = ''

    @property
    def power(self) -> float:
        """Sum of squares that a search lowers."""
        return float(self.residual @ self.residual + self.pulled @ self.pulled)
