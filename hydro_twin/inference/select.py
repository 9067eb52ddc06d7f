"""Choice of the next effect: each is fitted with the plant, and the fits are ranked by BIC."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
import math

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.linear import SUBSTEPS
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.drift_choice import is_drift_preferred
from hydro_twin.inference.noise import cannot_be_noise
from hydro_twin.inference.refinement import is_distinguishable, refine
from hydro_twin.inference.screen import places, ScoredEffect, screen, spans
from hydro_twin.inference.search import (
    LONG,
    problems_of,
    search_all,
    search_all_sticking,
    SHORT,
    sticks,
)
from hydro_twin.inference.starts import (
    best_start_of_each,
    drift_starts,
    linear_starts,
    relocated,
    shortlist,
    with_effect,
)
from hydro_twin.model import Model
from hydro_twin.parallel import in_processes

LEADING, RACING = 6, 4      # effects that promise most; evaluations from two starts of each
KEPT = 4                # effects that go on after that, and are fitted to convergence
WITHIN = 3.0            # ratio to the lowest error beyond which no refinement makes up for it
HOPELESS = 5.0          # and beyond which no longer search does, nor one more effect
PROMISING = 20.0        # likelihood ratio below which a score is chance


@dataclass(frozen=True)
class Alternative:
    """A fit with one effect more than the base: the last of the candidate's effects."""

    fit: Fit

    @property
    def placed(self) -> Placed:
        """The effect added."""
        return self.fit.candidate.effects[-1]

    @property
    def id(self) -> str:
        """Its id."""
        return self.placed.effect.id


def fit_alternatives(base: Fit, parts: Sequence[Part], times: tuple[float, float], most: int, *,
                     afresh: bool, progress: Callable[[str], None] = lambda _: None,
                     known: Sequence[Model] = (), most_error: float = math.inf
                     ) -> list[Alternative]:
    """Fit a base with one effect more, for each effect and port; best first.

    A low score does not rule an effect out: the parameters may imitate it at the base's values,
    but not at those of the full fit. An effect so confounded with them is always fitted. And a
    strong effect biases the linear fit so much that no search leads on from there. So a first
    round also starts from the middle of the box and from the fit by the one-step error.

    What a lag or a mode of a plant that integrates changes at high frequencies weighs much in the
    BIC, and hardly moves the output. So they are fitted apart, and one is chosen only where it
    leaves nothing but noise; else they are rivals of a delay.

    Args:
        base: the fit without the effect.
        parts: the data to fit.
        times: stamps [s] between which a parameter may drift.
        most: how many effects to fit, by their score, beside those that are confounded.
        afresh: whether to start with other values of the plant's parameters, too.
        progress: called with what is being fitted.
        known: further starting points, each with one effect more than the base.
        most_error: what leaves more is not searched on, nor refined.
    """
    progress(f'screening all effects{_beside(base.candidate.effects)}')
    scored = screen(base, parts)
    reach = spans(base.candidate, parts)
    confounded = [with_effect(base.candidate, Placed(effect, port, tuple(values)))
                  for effect, port in places(base.candidate.plant, base.candidate.effects)
                  if effect.confounded for values in effect.starts(reach[port])[:1]]
    if not afresh and nothing_shows(base, scored, _divided(confounded, parts)[0], parts):
        return []
    near = [*(with_effect(base.candidate, placed) for placed in shortlist(scored, most)),
            *confounded]
    plain = [*known, *drift_starts(base, parts, times)]
    if afresh:
        plain += best_start_of_each(linear_starts(base.candidate, parts), parts)
    tried, apart = _divided([*plain, *near], parts)
    found = fit_to_convergence(base, successive_halving(tried, parts, progress), parts, most_error)
    delayed = any(one.placed.effect.dynamic for one in found[:1])
    if not apart or not (delayed or cannot_be_noise(base.by_part)):
        return found
    dynamics = fit_to_convergence(
        base, successive_halving(apart, parts, progress), parts, most_error)
    if dynamics and not cannot_be_noise(dynamics[0].fit.by_part):
        return best_by_criterion([one.fit for one in (*found, *dynamics)])
    return [*found[:1], *dynamics, *found[1:]] if delayed else found


def _beside(effects: Sequence[Placed]) -> str:
    """Say beside which effects others are tried."""
    return ' beside ' + ' and '.join(one.effect.id for one in effects) if effects else ''


def _divided(candidates: Sequence[Model], parts: Sequence[Part]
             ) -> tuple[list[Model], list[Model]]:
    """Divide candidates into those to be fitted together, and the lags and modes fitted apart.

    These are apart where a plant integrates: its output hardly moves at the frequencies where a
    lag, a mode and a delay differ. Where it is whitened, these frequencies count.
    """
    together: list[Model] = []
    apart: list[Model] = []
    for one in candidates:
        effect = one.effects[-1].effect
        is_apart = (effect.dynamic and effect.law is not None and not parts[0].filters
                    and one.plant.integrates)
        (apart if is_apart else together).append(one)
    return together, apart


def successive_halving(candidates: Sequence[Model], parts: Sequence[Part],
                       progress: Callable[[str], None]) -> list[Fit]:
    """Search for a few evaluations from the candidates that promise most; best first.

    Successive halving [Jamieson and Talwalkar 2016] by effects and ports: first by what a linear
    step from each candidate would leave; then, after a few evaluations, the better of two
    candidates goes on, of fewer effects. The others stay as they are. What is confounded may lead
    only after a search, so it is always searched a little. The evaluations that only rank take few
    steps in a sample.
    """
    problems = problems_of([replace(candidate, substeps=min(candidate.substeps, SUBSTEPS))
                            for candidate in candidates], parts)
    beside = _beside(candidates[0].effects[:-1]) if candidates else ''
    promises = []
    for problem, (here, leaves) in zip(problems, in_processes(Problem.linear_prediction, problems),
                                       strict=True):
        last = problem.base.effects[-1]
        progress(f'trying {last.effect.id} at {last.port.name}{beside}')
        promises.append((leaves, problem.fit(here)))
    progress(f'fitting the best{beside}')
    ranked = at_each_place([fit for _, fit in sorted(promises, key=lambda one: one[0])])
    starts = [2 if rank < LEADING else int(fits[0].candidate.effects[-1].effect.confounded)
              for rank, fits in enumerate(ranked)]
    two = [fits[:count] for fits, count in zip(ranked, starts, strict=True) if count]
    short = search_all([fit.candidate for fits in two for fit in fits], parts, RACING)
    kept, left = leading(best_first([best_first(list(islice(short, len(fits))))[0]
                                     for fits in two]))
    substeps = max((candidate.substeps for candidate in candidates), default=SUBSTEPS)
    further = search_all([replace(fit.candidate, substeps=substeps) for fit in kept],
                         parts, SHORT - RACING)
    return best_first([*further, *left, *(
        fits[0] for fits, count in zip(ranked, starts, strict=True) if not count)])


def leading(ranked: Sequence[Fit]) -> tuple[list[Fit], list[Fit]]:
    """Divide fits into those that go on, the first KEPT, and the others; both in their order.

    A lag, a mode and a delay differ little until they are fitted to convergence, and hardly by
    their port. So with the first of them the others go on, each at its best port.
    """
    effects = [fit.candidate.effects[-1].effect for fit in ranked]
    first = {effect.id: rank for rank, effect in reversed([*enumerate(effects)])}
    dynamic = {rank for rank in first.values() if effects[rank].dynamic}
    kept = [rank for rank, effect in enumerate(effects)
            if rank in dynamic or not effect.dynamic][:KEPT]
    if dynamic.intersection(kept):
        kept = sorted(dynamic.union(kept))
    return [ranked[k] for k in kept], [fit for k, fit in enumerate(ranked) if k not in kept]


def nothing_shows(base: Fit, scored: Sequence[ScoredEffect], confounded: Sequence[Model],
                  parts: Sequence[Part]) -> bool:
    """Whether the residual is white and no effect has a score above chance.

    The score of a confounded one is what a linear step from its start would take off: a delay is
    spread over so many samples that a residual may hold much of it and look white.
    """
    chance = PROMISING / len(base.residual)
    if any(p.share >= chance for p in scored) or not is_white(base.by_part):
        return False
    without, *problems = problems_of([base.candidate, *confounded], parts)
    power = without.evaluate_base().sum_of_squares
    return all(1.0 - leaves / power < chance
               for _, leaves in in_processes(Problem.linear_prediction, problems))


def fit_to_convergence(base: Fit, ranked: Sequence[Fit], parts: Sequence[Part],
                       most_error: float = math.inf) -> list[Alternative]:
    """Fit the best to convergence, refine their last effects, and rank all of them.

    The law of the best is tried at its other ports, too, from its fit and from the base: the
    search from its own start there may have ended in a local minimum. Beside an effect that
    sticks, the best are searched by homotopy: a plain search hardly sees what else is missing.

    Args:
        base: the fit without the effect.
        ranked: one fit of each effect at each port, best first.
        parts: the data to fit.
        most_error: what leaves more after the race stays as it is.
    """
    if not ranked:
        return []
    most_error = min(most_error, HOPELESS * ranked[0].error)
    kept, left = leading([fit for fit in ranked if fit.error <= most_error])
    left += [fit for fit in ranked if fit.error > most_error]
    longer = list(search_all([fit.candidate for fit in kept], parts, LONG))
    near = WITHIN * min((fit.error for fit in longer), default=0.0)
    close = [fit for fit in longer if fit.error <= near]
    if sticks(base.candidate):
        close = list(search_all_sticking(close, parts))
    done = refine(close, parts)
    done += [fit for fit in longer if fit.error > near]
    for best in best_at_each_place(done)[:1]:
        moved = relocated(best.candidate, parts)
        moved += [replace(base.candidate, effects=there.effects) for there in moved]
        done += search_all(moved, parts, LONG)
    fits = [fit for fit in best_at_each_place([*done, *left])
            if is_distinguishable(fit, parts)]
    if fits and _drifts(fits[0]) and not is_drift_preferred(fits[0], parts):
        fits = [fit for fit in fits if not _drifts(fit)]
    return best_by_criterion(fits) if fits else []


def best_by_criterion(fits: Sequence[Fit]) -> list[Alternative]:
    """Rank fits by their BIC, the best first."""
    scores = delta_bic(fits)
    order = np.argsort(scores, kind='stable')
    return simplest_first([Alternative(fits[k]) for k in order], [scores[k] for k in order])


def _drifts(fit: Fit) -> bool:
    """Whether the last effect of a fit is a parameter that drifts."""
    return fit.candidate.effects[-1].effect.course is not None


def simplest_first(alternatives: list[Alternative], scores: Sequence[float]) -> list[Alternative]:
    """Move the simpler effect to the front, unless the best is clearly better by its BIC.

    Args:
        alternatives: best first.
        scores: their BIC.
    """
    simpler = alternatives[0].placed.effect.simpler
    for k, alternative in enumerate(alternatives):
        if alternative.id == simpler and scores[k] < scores[0] + CLEAR_DELTA_BIC:
            return [alternative, *alternatives[:k], *alternatives[k + 1:]]
    return alternatives


def best_first(fits: Sequence[Fit]) -> list[Fit]:
    """Sort fits by their cost."""
    return sorted(fits, key=lambda fit: fit.cost)


def at_each_place(fits: Sequence[Fit]) -> list[list[Fit]]:
    """Group fits by their last effect and its port, in the order of the first of each group."""
    groups: dict[tuple[str, str], list[Fit]] = {}
    for fit in fits:
        groups.setdefault(fit.candidate.effects[-1].key, []).append(fit)
    return list(groups.values())


def best_at_each_place(fits: Sequence[Fit]) -> list[Fit]:
    """Keep the best fit with each last effect at each port, best first."""
    return [group[0] for group in at_each_place(best_first(fits))]
