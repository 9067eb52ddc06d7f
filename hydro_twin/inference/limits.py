"""Limits that a recording never reached: where a fit leaves them means nothing."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import free_run
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import label, put, Unknown
from hydro_twin.model import Model


def without_unreached(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Take out of a fit each limit without which the runs are no worse by the BIC.

    All samples count as independent there: what a limit cuts off is a few of them, at peaks. A
    limit at the highest peak of a recording cuts off no more than its noise; another recording
    may go beyond it.

    Args:
        fit: a model with effects.
        parts: what it was fitted to.

    Returns:
        The fit with these limits where they limit nothing, and no longer among its unknowns.
    """
    limits = [(Unknown(p.name, str(index), p.lower, p.upper, p.log), p.unreached)
              for index, placed in enumerate(fit.candidate.effects)
              for p, _ in placed.in_use if p.unreached is not None]
    now = _sum_of_squares(fit.candidate, parts) if limits else 0.0
    least = math.log(sum(len(part.measured) for part in parts)) * fit.error**2
    for limit, unreached in limits:
        freed = put(fit.candidate, [limit], [unreached])
        then = _sum_of_squares(freed, parts)
        if then - now < least:
            now, kept = then, [label(unknown) != label(limit) for unknown in fit.unknowns]
            fit = replace(
                fit, candidate=freed, jacobian=fit.jacobian[:, kept],
                whitened=fit.whitened and (fit.whitened[0], fit.whitened[1][:, kept]),
                unknowns=tuple(u for u, keep in zip(fit.unknowns, kept, strict=True) if keep))
    return fit


def _sum_of_squares(model: Model, parts: Sequence[Part]) -> float:
    """Return that of the errors of free runs over the parts."""
    left = np.concatenate([part.measured - free_run(model, part) for part in parts])
    return float(left @ left)
