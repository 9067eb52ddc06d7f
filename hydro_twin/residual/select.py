"""Choosing an effect: full fits of the promising ones, compared by a criterion.

Every contender is fitted in full, with all physical parameters, from its own starts. They are
compared by Schwarz's criterion on residuals whitened alike, so that coloured noise does not
count as so many independent samples.
"""
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from hydro_twin.effects import Placed
from hydro_twin.fitting.free_run import (
    Candidate,
    Fit,
    Part,
    Problem,
    effect_unknowns,
    plant_unknowns,
    timing_unknowns,
)
from hydro_twin.plants.plant import FloatArray
from hydro_twin.residual.noise import autoregression, whiten
from hydro_twin.residual.screen import Prospect, screen, spans

TRIED = 9               # effects fitted in full in a round
KEPT = 4                # of these, searched to the end
SHORT, LONG = 7, 40     # evaluations of a search: to compare, to the end


@dataclass(frozen=True)
class Contender:
    """An effect added to the base and fitted in full; the last of the candidate's effects."""

    fit: Fit

    @property
    def placed(self) -> Placed:
        """The effect added."""
        return self.fit.candidate.effects[-1]

    @property
    def id(self) -> str:
        """Its id."""
        return self.placed.effect.id


def stretches(fit: Fit) -> list[FloatArray]:
    """Cut the residual of a fit back into its parts."""
    return np.split(fit.residual, np.cumsum(fit.lengths)[:-1])


def search(candidate: Candidate, parts: Sequence[Part], evaluations: int) -> Fit:
    """Fit all physical parameters, timing and effects of a candidate from where it stands."""
    plant = candidate.plant
    delayed = any(placed.effect.shifts for placed in candidate.effects)
    unknowns = plant_unknowns(plant, 'physical')
    unknowns += [] if delayed else timing_unknowns(plant, candidate.sample_time)
    for index, placed in enumerate(candidate.effects):
        unknowns += effect_unknowns(index, placed)
    return Problem(candidate, unknowns, parts).solve(evaluations, 1e-5)


def criterion(fits: Sequence[Fit]) -> list[float]:
    """Schwarz's criterion of fits to the same parts, whitened by the memory of the best.

    N ln(S/N) + d ln N, with S the sum of squares and d the number of unknowns that are not at
    the edge of their range.
    """
    best = min(fits, key=lambda fit: fit.cost)
    filter_ = autoregression(stretches(best))
    values = []
    for fit in fits:
        white = whiten(stretches(fit), filter_)
        n = len(white)
        power = float(white @ white)
        power *= 1.0 + fit.pulled / max(float(fit.residual @ fit.residual), 1e-300)
        free = len(fit.unknowns) - len(fit.at_bound())
        values.append(n * math.log(max(power, 1e-300) / n) + free * math.log(n))
    return values


def gain_p_value(before: Fit, after: Fit, tried: int) -> float:
    """Likelihood-ratio test of what the last effect adds, times the number of effects tried."""
    filter_ = autoregression(stretches(after))
    a, b = (whiten(stretches(fit), filter_) for fit in (before, after))
    ratio = len(a) * math.log(float(a @ a) / max(float(b @ b), 1e-300))
    added = max(1, len(after.unknowns) - len(before.unknowns))
    log_p = float(stats.chi2.logsf(max(ratio, 0.0), added)) + math.log(tried)
    return min(1.0, math.exp(max(log_p, -700.0)))


def contend(base: Fit, parts: Sequence[Part],
            progress: Callable[[str], None] = lambda _: None) -> list[Contender]:
    """Fit the promising effects on top of a base in full; best first."""
    prospects = screen(base, parts)
    tried: list[Fit] = []
    for placed in _shortlist(prospects):
        progress(f'{placed.effect.id} at {placed.port.name}')
        candidate = replace(base.candidate, effects=(*base.candidate.effects, placed))
        if placed.effect.shifts:
            candidate = replace(candidate, timing={})
        tried.append(search(candidate, parts, SHORT))
    return finish(tried, base, parts)


def finish(tried: Sequence[Fit], base: Fit, parts: Sequence[Part]) -> list[Contender]:
    """Search the best fits to the end, refine their last effects, and rank all of them."""
    best: dict[tuple[str, str], Fit] = {}
    for fit in sorted(tried, key=lambda fit: fit.cost):
        last = fit.candidate.effects[-1]
        best.setdefault((last.effect.id, last.port.name), fit)
    ranked = sorted(best.values(), key=lambda fit: fit.cost)
    done = [search(fit.candidate, parts, LONG) for fit in ranked[:KEPT]]
    done = [refine(fit, parts) for fit in done]
    fits = done + ranked[KEPT:]
    if not fits:
        return []
    order = np.argsort(criterion(fits), kind='stable')
    return [Contender(fits[k]) for k in order]


def refine(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Let in the refinements of the last effect where the criterion is clearly better for it."""
    last = fit.candidate.effects[-1]
    if last.effect.refined is None:
        return fit
    reach = spans(fit.candidate, parts)[last.port]
    forms = [fit]
    for values in last.effect.refined(reach, last.values):
        effects = (*fit.candidate.effects[:-1], replace(last, values=tuple(values)))
        forms.append(search(replace(fit.candidate, effects=effects), parts, LONG // 2))
    scores = criterion(forms)
    best = int(np.argmin(scores))
    return forms[best] if scores[best] < scores[0] - CLEARLY else fit


CLEARLY = 10.0          # difference of the criterion from which one law is preferred to another


def _shortlist(prospects: Sequence[Prospect]) -> list[Placed]:
    """Take the best effects, each on each port: two starts for the best four, one for others."""
    order: list[tuple[str, str, str]] = []
    starts: dict[tuple[str, str, str], list[Placed]] = {}
    for prospect in prospects:
        placed = prospect.placed
        key = (placed.effect.id, placed.port.name, placed.port.kind)
        if key not in starts:
            order.append(key)
        starts.setdefault(key, []).append(placed)
    return [placed for rank, key in enumerate(order[:TRIED])
            for placed in starts[key][:2 if rank < 4 else 1]]
