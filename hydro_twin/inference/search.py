"""Searches for the parameters, timing and effects of a model: free runs, or by homotopy."""
from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.homotopy import search_by_homotopy
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem, solve_all
from hydro_twin.fitting.unknowns import unknowns_of
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.model import Model
from hydro_twin.parallel import in_processes

SHORT, LONG = 10, 40    # evaluations of a search: to compare, to converge
TOLERANCE = 1e-5        # relative reduction of the sum of squares that ends one: of 10,000 samples
#                         a log-likelihood of 0.05


def search(candidate: Model, parts: Sequence[Part], evaluations: int) -> Fit:
    """Fit all unknowns of a candidate from their present values, see `unknowns_of`."""
    return next(search_all([candidate], parts, evaluations))


def search_all(candidates: Sequence[Model], parts: Sequence[Part], evaluations: int
               ) -> Iterator[Fit]:
    """Fit several, on all cores, and yield the fits in their order."""
    return solve_all(problems_of(candidates, parts), evaluations, TOLERANCE)


def search_sticking(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Search by homotopy a model that sticks and leaves more than white noise; see `sticks`."""
    return next(search_all_sticking([fit], parts))


def search_all_sticking(fits: Sequence[Fit], parts: Sequence[Part]) -> Iterator[Fit]:
    """Search several, on all cores, and yield the fits in their order."""
    return in_processes(partial(_search_sticking, parts), fits)


def _search_sticking(parts: Sequence[Part], fit: Fit) -> Fit:
    if not sticks(fit.candidate) or is_white(fit.by_part):
        return fit
    return search_by_homotopy(fit, parts, LONG, TOLERANCE)


def sticks(candidate: Model) -> bool:
    """Whether a model has dry friction or a stop, and a search by homotopy may help.

    Not of a plant that integrates: what moves it without bound, as a constant force, moves it by
    next to nothing with feedback, so that this tells little of the laws.
    """
    return not candidate.plant.integrates and any(
        placed.effect.implicit for placed in candidate.effects)


def unsearched(candidate: Model, parts: Sequence[Part]) -> Fit:
    """Take a candidate as it is for a fit."""
    return problems_of([candidate], parts)[0].unsearched()


def problems_of(candidates: Sequence[Model], parts: Sequence[Part]) -> list[Problem]:
    """Set up the fit of each candidate."""
    return [Problem(candidate, unknowns_of(candidate), parts) for candidate in candidates]
