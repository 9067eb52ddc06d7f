"""Trends of the parameters of a rig over its periods."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
import math
from typing import Any

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from hydro_twin.arrays import FloatArray

TREND = 3.0             # score from which a trend is shown
PERIODS = 3             # at least, for a trend
RIGS = 3                # at least, to say how well a measurement repeats
YEAR = 365.25 * 86400.0  # [s]

Row = dict[str, Any]


def trend_of(rig: Row, usual: Mapping[str, Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return the clearest trend of a rig over its periods; None if none is clear."""
    found = []
    for name, one in usual.items():
        if (points := _over_time(rig, name, one['log'])) is None:
            continue
        slope, error, score = line(*points).scored(one['repeatability'])
        if abs(score) >= TREND:
            found.append({'name': name, 'log': one['log'], 'score': score, 'std_error': error,
                          'per_year': math.expm1(slope) if one['log'] else slope,
                          'unit': one['unit']})
    return max(found, key=lambda one: abs(one['score']), default=None)


def effect_name(effect: Mapping[str, Any]) -> str:
    """Name an effect with its place, as the estimates do."""
    return f'{effect["id"]} at {effect["port"]}'


def same_effects(rig: Row) -> list[dict[str, Any]]:
    """List the periods with the effects of the last: what a model lacks bends its parameters."""
    return [period for period in rig['periods']
            if list(map(effect_name, period['effects'])) == rig['effects']]


def repeatability(rigs: Sequence[Row], name: str, log: bool) -> float | None:
    """Say how much more a parameter scatters from period to period than its standard errors say.

    Two recordings of a rig differ by more than the noise within each: it is warmer, or moves
    otherwise. Few periods of one rig do not show by how much; those of its group do. The median
    over the rigs leaves out one that does not follow a line.

    Returns:
        The factor for the variance, one at least; None from fewer than three rigs.
    """
    lines = [line(*points) for rig in rigs
             if (points := _over_time(rig, name, log)) is not None]
    ratios = [one.ratio * one.free / chi2.median(one.free) for one in lines]
    return max(1.0, float(np.median(ratios))) if len(ratios) >= RIGS else None


def _over_time(rig: Row, name: str, log: bool) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return time [years], values and standard errors of a parameter; None if too few."""
    points = [(datetime.fromisoformat(period['date']).timestamp() / YEAR, one['value'],
               one['std_error']) for period in same_effects(rig)
              if (one := period['estimates'].get(name)) and period['date']
              and (one['value'] > 0.0 or not log)]
    if len(points) < PERIODS or len({when for when, _, _ in points}) < PERIODS:
        return None
    time, value, error = np.array(points).T
    return (time, np.log(value), error / value) if log else (time, value, error)


@dataclass(frozen=True)
class Line:
    """A straight line through the periods of a rig.

    Attributes:
        slope: a year.
        std_error: of the slope, as the standard errors of the points have it.
        ratio: of the squares of the residuals to what the standard errors say.
        free: degrees of freedom.
    """

    slope: float
    std_error: float
    ratio: float
    free: int

    def scored(self, factor: float | None) -> tuple[float, float, float]:
        """Return the slope, its standard error, and its score, a quantile of the normal.

        Args:
            factor: for the variance of the points; None: by how much they scatter, with
                Student's distribution, since that is then known from few points only
                (R. T. Birge, Phys. Rev. 40 (1932) 207-227).
        """
        if factor is not None:
            error = self.std_error * math.sqrt(factor)
            return self.slope, error, self.slope / error
        error = self.std_error * math.sqrt(max(1.0, self.ratio))
        tail = student.sf(abs(self.slope) / error, self.free)
        return self.slope, error, math.copysign(float(norm.isf(max(tail, 1e-300))), self.slope)


def line(x: FloatArray, y: FloatArray, s: FloatArray) -> Line:
    """Fit a straight line by weighted least squares.

    Args:
        x: (n,), n >= 3.
        y: (n,).
        s: (n,), standard errors.
    """
    w = s ** -2
    x = x - np.average(x, weights=w)
    squares = float(w @ x ** 2)
    mean = np.average(y, weights=w)
    slope = float(w @ (x * y)) / squares
    free = len(x) - 2
    return Line(slope, squares ** -0.5, float(w @ (y - mean - slope * x) ** 2) / free, free)
