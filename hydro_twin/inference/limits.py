"""Limits that a recording never reached: where a fit leaves them means nothing."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import free_run
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import label, put, Unknown
from hydro_twin.predictors.scores import rms

UNREACHED = 1e-3        # change of the run, as a share of the residual, that no data can show


def without_unreached(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Take out of a fit each limit without which the runs are the same.

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
            changes = [free_run(freed, part) - free_run(fit.candidate, part) for part in parts]
            if rms(np.concatenate(changes)) <= UNREACHED * fit.error:
                kept = [label(unknown) != label(limit) for unknown in fit.unknowns]
                fit = replace(
                    fit, candidate=freed, jacobian=fit.jacobian[:, kept],
                    whitened=fit.whitened and (fit.whitened[0], fit.whitened[1][:, kept]),
                    unknowns=tuple(u for u, keep in zip(fit.unknowns, kept, strict=True) if keep))
    return fit
