"""A fit: a model fitted to parts of a recording, with its residual and the derivatives of that."""
from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.identifiability import assess, Identifiability
from hydro_twin.fitting.unknowns import get, label, Unknown
from hydro_twin.model import Model
from hydro_twin.plants.combinations import product_of_powers
from hydro_twin.predictors.scores import rms


@dataclass(frozen=True)
class Fit:
    """A candidate fitted to parts.

    Attributes:
        residual: of all parts, one after another, scored samples only. Where there are sensors,
            theirs follow in each part, all scaled to weigh by their noise, see `outputs`.
        jacobian: its derivative by the coordinates of the unknowns, with the sign of a rise of
            the output, shape (N, d).
        lengths: scored samples of each piece of it, those of the output or of a sensor in a part.
        penalty: what leaving the usual values costs, as a sum of squares.
        outputs: which output each piece is of: 0, or one more than the index of the sensor.
        sensors: names of those that were fitted.
        scales: by which the residual of output and sensors was multiplied, (1 + K,).
        whitened: residual and derivative as they were fitted, where that was by the likelihood of
            coloured noise; None where the noise was taken as white.
    """

    candidate: Model
    unknowns: tuple[Unknown, ...]
    residual: FloatArray
    jacobian: FloatArray
    lengths: tuple[int, ...]
    penalty: float
    outputs: tuple[int, ...] = ()
    sensors: tuple[str, ...] = ()
    scales: FloatArray = field(default_factory=lambda: np.ones(1))
    whitened: tuple[FloatArray, FloatArray] | None = None

    @property
    def main(self) -> Fit:
        """The same with the pieces of the output alone, in its unit."""
        if not self.sensors:
            return self
        own = np.array(self.outputs) == 0
        rows, scale = np.repeat(own, self.lengths), self.scales[0]
        return replace(
            self, residual=self.residual[rows] / scale, jacobian=self.jacobian[rows] / scale,
            lengths=tuple(np.array(self.lengths)[own].tolist()), penalty=self.penalty / scale**2,
            outputs=(), sensors=(), scales=np.ones(1), whitened=None)

    @property
    def by_output(self) -> list[list[FloatArray]]:
        """The residuals of the output, and of each sensor, by part, each in its unit."""
        pieces = np.split(self.residual, np.cumsum(self.lengths)[:-1])
        outputs = self.outputs or (0,) * len(pieces)
        return [[piece / scale for piece, output in zip(pieces, outputs, strict=True)
                 if output == q] for q, scale in enumerate(self.scales)]

    @property
    def by_part(self) -> list[FloatArray]:
        """The residual of the output by part."""
        return self.by_output[0]

    @property
    def noise(self) -> dict[str, float]:
        """RMS of what is left of output and sensors, each in its unit."""
        every = np.repeat(self.outputs or (0,) * len(self.lengths), self.lengths)
        names = (self.candidate.plant.output.name, *self.sensors)
        return {name: rms(self.residual[every == q]) / float(self.scales[q])
                for q, name in enumerate(names)}

    @property
    def cost(self) -> float:
        """Root mean square of the residual with what leaving the usual values costs."""
        return math.sqrt((float(self.residual @ self.residual) + self.penalty)
                         / max(len(self.residual), 1))

    @property
    def error(self) -> float:
        """RMS of the residual of the output, in its unit."""
        return rms(np.concatenate(self.by_part))

    @property
    def free(self) -> int:
        """How many of what was fitted are not at an edge of their range."""
        return self.fitted - len(self.at_bound())

    @property
    def fitted(self) -> int:
        """How many numbers were fitted: the unknowns, and those of loads that swing."""
        return len(self.unknowns) + self.swings

    @property
    def swings(self) -> int:
        """How many numbers say how loads swing at the start of each part."""
        each = sum(placed.swings for placed in self.candidate.effects)
        return each * len(self.by_part)

    @property
    def tangent_basis(self) -> FloatArray:
        """An orthonormal basis of what re-estimated parameters can do to the residual, (N, b)."""
        basis: FloatArray = np.linalg.qr(self.jacobian)[0]
        return basis

    def at_bound(self) -> list[str]:
        """Name the unknowns that stopped at an edge of their range."""
        names = []
        for unknown in self.unknowns:
            value = unknown.coordinate(get(self.candidate, unknown))
            edges = [unknown.coordinate(edge) for edge in (unknown.lower, unknown.upper)
                     if math.isfinite(edge) and (edge > 0 or not unknown.log)]
            if any(abs(value - edge) < 1e-4 * max(1.0, abs(edge)) for edge in edges):
                names.append(label(unknown))
        return names

    def identifiability(self) -> Identifiability:
        """Say what the data determine; see `identifiability`."""
        residual, jacobian = self.whitened or (self.residual, self.jacobian)
        cuts = np.cumsum(self.lengths)[:-1]
        stretches = zip(np.split(jacobian, cuts), np.split(residual, cuts), strict=True)
        names = [label(unknown) for unknown in self.unknowns]
        combinations = self.candidate.plant.combinations
        inside = [c for c in combinations if all(name in names for name in c)]
        known = assess(stretches, names, inside, self.at_bound())
        # Of the others only the first member is searched: its error is that of the product.
        return replace(known, combinations={**known.combinations, **{
            product_of_powers(c.items()): known.std_error.get(next(iter(c)))
            for c in combinations if c not in inside}})


def project_out(columns: FloatArray, basis: FloatArray) -> FloatArray:
    """Take from columns (N, ...) what an orthonormal basis (N, b) explains of them."""
    rest: FloatArray = columns - basis @ (basis.T @ columns)
    return rest
