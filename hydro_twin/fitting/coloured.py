"""Maximum-likelihood fit with coloured noise, modelled as an autoregressive process.

Least squares weights all frequencies equally. If the noise is mostly at low frequencies, it gives
too little weight to the high ones, and the estimates have a larger variance than necessary. So the
noise model and the parameters are estimated in turn: an autoregressive model of the residual, then
a fit to the data that it whitens [Cochrane and Orcutt 1949].

This is valid for noise only. A missing law also leaves a coloured residual, and a filter would
hide it. So the residual must pass three tests: the port signals do not predict that of the
output, whitening leaves no autocorrelation, and the two estimates differ by no more than their
standard errors explain [Hausman 1978].
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import scipy

from hydro_twin.fitting.autoregression import (
    autoregression,
    effective_gain,
    noise_filter,
    whiten,
)
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import P_PREDICTED, predicted_by_ports
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.predictors.scores import rms

TURNS = 2               # fits, each with the noise of the one before; a third moves an estimate by
#                         less than a hundredth of its standard error
MAX_INNOVATION_RATIO = 0.5  # RMS of what is new in each sample over that of all: a fourth of the
#                         power
MAX_SAMPLES = 100_000   # samples; the test of more takes gigabytes, and so many tell enough
CHANCE = 1e-3           # level at which two fits differ by more than their scatter


def is_coloured(fit: Fit) -> bool:
    """Whether past residuals of the output predict most of the power of the present one.

    Least squares is then far from efficient.
    """
    pieces = fit.by_part
    return rms(whiten(pieces, autoregression(pieces))) < MAX_INNOVATION_RATIO * fit.error


def whitened(parts: Sequence[Part], fit: Fit) -> list[Part]:
    """Take what a fit leaves as the noise of output and sensors: parts that whiten it.

    Args:
        parts: that are to be fitted.
        fit: to the like of them, as they are.
    """
    filters = tuple(map(noise_filter, fit.by_output))
    return [replace(part, filters=filters) for part in parts]


def as_measured(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Return a fit to whitened parts with the residual as it is.

    What it determines stays what the whitened parts do.

    Args:
        fit: to whitened parts.
        parts: the same without filters.
    """
    plain = Problem(fit.candidate, fit.unknowns, parts).unsearched()
    return replace(plain, whitened=(fit.residual, fit.jacobian))


def with_coloured_noise(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Fit again by the likelihood of coloured noise, if that is what is left.

    Args:
        fit: of a model.
        parts: what it was fitted to.

    Returns:
        The fit with the filters of the noise; the same fit where it has them, or where what is
        left is white, or no noise.
    """
    if (fit.whitened or len(fit.residual) > MAX_SAMPLES or all(map(is_white, fit.by_output))
            or predicted_by_ports(fit, parts)[1] < P_PREDICTED):
        return fit
    again = fit
    for _ in range(TURNS):
        white = Problem(again.candidate, fit.unknowns, whitened(parts, again)).solve()
        if not all(map(is_white, white.by_output)):
            return fit
        again = as_measured(white, parts)
    is_noise = not _differ(fit, again) and predicted_by_ports(again, parts)[1] > P_PREDICTED
    return again if is_noise else fit


def _differ(ordinary: Fit, coloured: Fit) -> bool:
    """Whether the fit with coloured noise differs significantly from that by least squares.

    If the residual is noise, both estimate the same parameters. The rise of the sum of squares
    above its minimum, as twice a log-likelihood, is then chi-square distributed with as many
    degrees of freedom as there are unknowns.
    """
    pairs = zip(coloured.by_output, ordinary.by_output, strict=True)
    rise = sum(effective_gain(*pair) for pair in pairs)
    return bool(rise > scipy.stats.chi2.isf(CHANCE, len(ordinary.unknowns)))
