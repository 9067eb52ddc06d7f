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


def without_unreached(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Take out of a fit each limit without which the runs are no worse by the BIC.

    A limit at the highest peak of a recording cuts off no more than its noise; another recording
    may go beyond it.

    Args:
        fit: a model with effects.
        parts: what it was fitted to.

    Returns:
        The fit with these limits where they limit nothing, and no longer among its unknowns.
    """
    for index, placed in enumerate(fit.candidate.effects):
        for p in placed.effect.parameters:
            if p.unreached is None or placed.named[p.name] == p.unreached:
                continue
            limit = Unknown(p.name, str(index), p.lower, p.upper, p.log)
            freed = put(fit.candidate, [limit], [p.unreached])
            now, then = (np.concatenate([part.measured - free_run(model, part) for part in parts])
                         for model in (fit.candidate, freed))
            if then @ then - now @ now < math.log(len(now)) * fit.error**2:
                kept = [label(unknown) != label(limit) for unknown in fit.unknowns]
                fit = replace(
                    fit, candidate=freed, jacobian=fit.jacobian[:, kept],
                    whitened=fit.whitened and (fit.whitened[0], fit.whitened[1][:, kept]),
                    unknowns=tuple(u for u, keep in zip(fit.unknowns, kept, strict=True) if keep))
    return fit
