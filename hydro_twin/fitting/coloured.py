"""The fit where what is left is coloured noise: by its likelihood as an autoregressive process.

Least squares weighs all frequencies alike. Where the noise is mostly slow, the fast ones tell more
of the parameters than it allows for: the estimates scatter more than they need. So the noise is
estimated with the fit, in turn: the process of what is left, then the fit of what it whitens
[Cochrane and Orcutt 1949].

That holds for noise only. What a law that is lacking leaves is coloured, too, and a filter would
hide it. So what is left must be noise by two tests: the port signals do not predict that of the
output, and the process explains all of its memory.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydro_twin.fitting.autoregression import noise_filter
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import PREDICTED, predicted_by_ports
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.whiteness import is_white

TURNS = 2               # fits, each with the noise of the one before; a third moves an estimate by
#                         less than a hundredth of its standard error
MOST = 100_000          # samples; the test of more takes gigabytes, and so many tell enough


def with_coloured_noise(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Fit again by the likelihood of coloured noise, if that is what is left.

    Args:
        fit: of a model, by least squares.
        parts: what it was fitted to.

    Returns:
        The fit with the filters of the noise; the same fit where what is left is white, or no
        noise.
    """
    if (len(fit.residual) > MOST or all(map(is_white, fit.by_output))
            or predicted_by_ports(fit, parts)[1] < PREDICTED):
        return fit
    again = fit
    for _ in range(TURNS):
        filters = [noise_filter(pieces) for pieces in again.by_output]
        white = Problem(again.candidate, fit.unknowns, parts, filters).solve()
        if not all(map(is_white, white.by_output)):
            return fit
        again = replace(Problem(white.candidate, fit.unknowns, parts).as_it_is(),
                        whitened=(white.residual, white.jacobian))
    return again if predicted_by_ports(again, parts)[1] > PREDICTED else fit
