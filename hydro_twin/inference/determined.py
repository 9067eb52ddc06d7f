"""Effects of a size that the data do not determine: they only change the initial states."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.fitting.coloured import with_coloured_noise
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import label
from hydro_twin.inference.findings import other_findings, Selection
from hydro_twin.inference.search import LONG, search

WIDEST = 0.5            # relative standard error up to which a size differs from none at all: a
#                         fall to zero is two standard errors


def without_undetermined(selection: Selection, base: Fit, parts: Sequence[Part]) -> Selection:
    """Drop each effect with a state of its own that no part of the data determines.

    The initial state of each part is free. Where the model misses much, a filter of any time
    constant, or a loop of any width, may make up for some of it there, and so in all that follows,
    on held-out data, too.

    Args:
        selection: a model that was found.
        base: the fit without any of its effects.
        parts: what it was fitted to.

    Returns:
        The remaining selection, fitted with coloured noise where its residual is coloured.
    """
    selection = replace(selection, fit=with_coloured_noise(selection.fit, parts))
    for k, found in enumerate(selection.findings):
        if not is_determined(selection.fit, found.index):
            others = other_findings(selection, k)
            without = base if not others else search(
                selection.fit.candidate.without(found.index), parts, LONG)
            return without_undetermined(Selection(without, others), base, parts)
    return selection


def is_determined(fit: Fit, index: int) -> bool:
    """Whether the data determine any size of an effect, if that has a state of its own.

    What they determine only together with a parameter of the plant is determined.
    """
    effect = fit.candidate.effects[index].effect
    if not (effect.memory or effect.dynamic):
        return True
    known = fit.identifiability()
    errors = dict(zip(known.coordinates, np.sqrt(np.diag(known.covariance)), strict=True))
    sizes = [errors.get(label(unknown), np.inf) for unknown in fit.unknowns
             if unknown.owner == str(index) and unknown.log]
    return not sizes or min(sizes) < WIDEST
