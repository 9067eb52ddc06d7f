"""Whether parameters change with time, or only differ from one recording to the next."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.criterion import delta_bic


def is_drift_preferred(drift: Fit, apart: Sequence[Fit]) -> bool:
    """Whether a drift describes recordings better than a model of its own for each, by BIC.

    Args:
        drift: a fit with a parameter that drifts, to all.
        apart: those without it, one to each.
    """
    steady, different = delta_bic([drift.main, joined(apart)],
                                  [drift.free, sum(fit.free for fit in apart)])
    return steady < different


def by_recording(parts: Sequence[Part], sample_time: float) -> list[list[Part]]:
    """Group parts that are windows of one recording: there is no gap between them."""
    period = 1e9 * sample_time
    gaps = [abs(after.start - before.start - period * len(before.measured)) > 2.0 * period
            for before, after in pairwise(parts)]
    groups = [[part] for part in parts[:1]]
    for part, apart in zip(parts[1:], gaps, strict=True):
        if apart:
            groups.append([])
        groups[-1].append(part)
    return groups


def joined(fits: Sequence[Fit]) -> Fit:
    """Join fits of one model to one recording each: its output, with the unknowns of all."""
    mains = [fit.main for fit in fits]
    return replace(
        mains[0], unknowns=tuple(chain.from_iterable(fit.unknowns for fit in mains)),
        residual=np.concatenate([fit.residual for fit in mains]),
        lengths=tuple(chain.from_iterable(fit.lengths for fit in mains)),
        penalty=sum(fit.penalty for fit in mains),
        jacobian=np.zeros((sum(len(fit.residual) for fit in mains), 0)))
