"""Whether parameters change with time, or only differ from one recording to the next."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hydro_twin.arrays import IntArray
from hydro_twin.fitting.fit import Fit, project_out
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import coordinates_of
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic


def is_drift_preferred(drift: Fit, parts: Sequence[Part]) -> bool:
    """Whether a drift is clearly better, by BIC, than constants that differ between stretches.

    These are the parameter that drifts, or all parameters, with a value for each recording. They
    only miss what the drift changes within a recording, so the model is linearised for them.

    Args:
        drift: a fit whose last effect is a parameter that drifts.
        parts: what it was fitted to.
    """
    stretches = stretch_of(parts, drift.candidate.sample_time)
    if not stretches.any():
        return True
    fit, last = drift.main, len(drift.candidate.effects) - 1
    port = drift.candidate.effects[last].port.name
    of_drift = [k for k, unknown in enumerate(fit.unknowns) if unknown.owner == str(last)]
    parameters = [k for k, unknown in enumerate(fit.unknowns) if unknown.owner == '']
    apart = [[k for k in parameters if fit.unknowns[k].name == port], parameters]
    with_drift, *constant = delta_bic(
        [fit, *(_with_constants(fit, of_drift, some, stretches) for some in apart)],
        [fit.fitted, *(fit.fitted - len(of_drift) + len(some) * int(stretches[-1])
                       for some in apart)])
    return with_drift + CLEAR_DELTA_BIC < min(constant)


def stretch_of(parts: Sequence[Part], sample_time: float) -> IntArray:
    """Return the uninterrupted stretch that each part belongs to, numbered from 0."""
    period = 1e9 * sample_time
    gaps = [abs(after.start - before.start - period * len(before.measured)) > 2.0 * period
            for before, after in pairwise(parts)]
    return np.cumsum([0, *gaps])


def _with_constants(fit: Fit, of_drift: Sequence[int], apart: Sequence[int],
                    stretches: IntArray) -> Fit:
    """Replace a drift by a value of some unknowns for each recording.

    Args:
        fit: with the drift.
        of_drift: its unknowns; the output is linear in the rate.
        apart: the unknowns that differ between stretches.
        stretches: that of each part.
    """
    rate = next(k for k in of_drift if fit.unknowns[k].name == 'rate')
    contribution = fit.jacobian[:, rate] * coordinates_of(fit.candidate, fit.unknowns)[rate]
    common = sorted({*range(len(fit.unknowns))} - {*of_drift, *apart})
    rows = np.repeat(stretches, fit.lengths)
    columns = [fit.jacobian[:, common], *(
        fit.jacobian[:, apart] * (rows == k)[:, None] for k in range(rows[-1] + 1))]
    basis = np.linalg.qr(np.column_stack(columns))[0]
    return replace(fit, residual=project_out(fit.residual + contribution, basis))
