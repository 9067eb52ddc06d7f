"""Effects of a size that the data do not determine, or that is too small to be measured."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.fitting.coloured import with_coloured_noise
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem, solve_all
from hydro_twin.fitting.unknowns import get, label, put, Unknown
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.effect_signals import effect_signals
from hydro_twin.inference.findings import other_findings, Selection
from hydro_twin.inference.refinement import unrefined
from hydro_twin.inference.screen import spans
from hydro_twin.inference.search import LONG, search, TOLERANCE
from hydro_twin.inference.starts import with_other

WIDEST = 0.5            # relative standard error up to which a size differs from none at all: a
#                         fall to zero is two standard errors
RESOLUTION = 1e-4       # of the range of a port's value: what adds less is too small to be there.
#                         Converters resolve 2.4e-4 (12 bits) to 1.5e-5 (16 bits) of their range


def without_undetermined(selection: Selection, base: Fit, parts: Sequence[Part]) -> Selection:
    """Drop each effect that is not resolved, or has a state of its own that is not determined.

    The initial state of each part is free. Where the model misses much, a filter of any time
    constant, or a loop of any width, may make up for some of it there, and so in all that follows,
    on held-out data, too. A refinement is dropped first: it may share the size with the
    simple law.

    Args:
        selection: a model that was found.
        base: the fit without any of its effects.
        parts: what it was fitted to.

    Returns:
        The remaining selection, fitted with coloured noise where its residual is coloured.
    """
    selection = replace(selection, fit=with_coloured_noise(selection.fit, parts))
    for k, found in enumerate(selection.findings):
        if not (is_resolved(selection.fit, found.index, parts)
                and is_determined(selection.fit, found.index, parts)):
            candidate = selection.fit.candidate
            simple = unrefined(candidate.effects[found.index])
            if simple != candidate.effects[found.index]:
                fit = search(with_other(candidate, found.index, simple), parts, LONG)
                return without_undetermined(replace(selection, fit=fit), base, parts)
            others = other_findings(selection, k)
            without = base if not others else search(candidate.without(found.index), parts, LONG)
            return without_undetermined(Selection(without, others), base, parts)
    return selection


def is_resolved(fit: Fit, index: int, parts: Sequence[Part]) -> bool:
    """Whether what a law adds anywhere is enough to be there, against the range of its port.

    A plant that integrates adds up what is smaller than any converter resolves, such as the errors
    of the times at which a command acts, until a law that makes up for it is significant.
    """
    placed = fit.candidate.effects[index]
    if placed.effect.law is None:
        return True
    ranges = spans(fit.candidate, parts)[placed.port].ranges
    least = RESOLUTION * max(high - low for low, high in ranges)
    return any(float(np.abs(effect_signals(fit.candidate, placed, part).added).max()) > least
               for part in parts)


def is_determined(fit: Fit, index: int, parts: Sequence[Part]) -> bool:
    """Whether the data determine any size of an effect, if that has a state of its own.

    What they determine only together with a parameter of the plant is determined. Where the
    standard error is wide, a profile decides: the model may depart from what its derivatives
    promise, as where a delay stands beside an inertia that may be small.
    """
    placed = fit.candidate.effects[index]
    if not (placed.remembers or placed.effect.dynamic):
        return True
    known = fit.identifiability()
    errors = dict(zip(known.coordinates, np.sqrt(np.diag(known.covariance)), strict=True))
    sizes = [unknown for unknown in fit.unknowns if unknown.owner == str(index) and unknown.log]
    return not sizes or any(errors.get(label(size), np.inf) < WIDEST
                            or _is_half_worse(fit, size, parts) for size in sizes)


def _is_half_worse(fit: Fit, size: Unknown, parts: Sequence[Part]) -> bool:
    """Whether half the size fits clearly worse, with all other unknowns fitted to it."""
    half = put(fit.candidate, [size], [0.5 * get(fit.candidate, size)])
    others = [unknown for unknown in fit.unknowns if unknown is not size]
    (held,) = solve_all([Problem(half, others, parts)], LONG, TOLERANCE)
    whole, then = delta_bic([fit, held])
    return then > whole + CLEAR_DELTA_BIC
