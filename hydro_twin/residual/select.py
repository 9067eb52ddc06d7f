"""Choosing the next effect: alternatives are fitted with the plant and compared by their BIC.

Each alternative is fitted together with all physical parameters, from its own starting points. The
BIC is that of the residuals after one whitening filter for all, so that samples of coloured noise
do not count as independent.
"""
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress, islice, takewhile
import math

import numpy as np
from scipy import stats

from hydro_twin.effects import Placed
from hydro_twin.fitting.equation_error import one_step_values
from hydro_twin.fitting.free_run import Fit, Problem, solve_all
from hydro_twin.fitting.horizon import between_ends
from hydro_twin.fitting.output_error import initial_states, residuals, residuals_from
from hydro_twin.fitting.parallel import in_processes
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import (
    effect_unknowns,
    plant_unknowns,
    timing_unknowns,
    Unknown,
    usual,
)
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.model import Model, place
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms
from hydro_twin.residual.noise import autoregression, whiten
from hydro_twin.residual.screen import places, Prospect, screen, spans
from hydro_twin.residual.structure import drift, drifting, drifts

AGAIN = 5               # effects with the best scores that are searched from two starting points
RACING, LEADING = 4, 10     # evaluations of every search; effects that are then searched on
KEPT = 4                # effects that are fitted to convergence
SHORT, LONG = 10, 40    # evaluations of a search: to compare, to converge
WITHIN = 3.0            # ratio to the lowest error beyond which no refinement makes up for it
HOPELESS = 5.0          # and beyond which no longer search does
PROMISING = 20.0        # likelihood ratio below which a score is chance
CLEARLY = 10.0          # difference of the BIC from which one law is preferred to another


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


def by_part(fit: Fit) -> list[FloatArray]:
    """Split the residual of the output of a fit into its parts."""
    return by_output(fit)[0]


def by_output(fit: Fit) -> list[list[FloatArray]]:
    """Split the residual of a fit into those of the output, and of each sensor, by part."""
    pieces = np.split(fit.residual, np.cumsum(fit.lengths)[:-1])
    outputs = fit.outputs or (0,) * len(pieces)
    return [[piece / scale for piece, output in zip(pieces, outputs, strict=True) if output == q]
            for q, scale in enumerate(fit.scales)]


def search(candidate: Model, parts: Sequence[Part], evaluations: int) -> Fit:
    """Fit all physical parameters, timing and effects of a candidate from its present values.

    Effects beside which a free curve was added are held, since the curve can imitate them.
    """
    return next(search_all([candidate], parts, evaluations))


def search_all(candidates: Sequence[Model], parts: Sequence[Part], evaluations: int
               ) -> Iterator[Fit]:
    """Fit several, on all cores, and yield the fits in their order."""
    return solve_all(_problems(candidates, parts), evaluations, 1e-5)


def _problems(candidates: Sequence[Model], parts: Sequence[Part]) -> list[Problem]:
    """Set up the fit of each candidate."""
    return [Problem(candidate, searched(candidate), parts) for candidate in candidates]


def searched(candidate: Model) -> list[Unknown]:
    """List the unknowns of a candidate, see `search`."""
    plant = candidate.plant
    delayed = any(placed.effect.shifts for placed in candidate.effects)
    unknowns = plant_unknowns(plant, 'physical')
    unknowns += [] if delayed else timing_unknowns(plant, candidate.sample_time)
    held = max((k for k, placed in enumerate(candidate.effects) if not placed.effect.named),
               default=0)
    for index, placed in enumerate(candidate.effects[held:], held):
        unknowns += effect_unknowns(index, placed)
    return unknowns


def criterion(fits: Sequence[Fit]) -> list[float]:
    """BIC of fits to the same parts, their residuals whitened by the filters of the best.

    N ln(S/N) + d ln N, with S the sum of squares and d the number of unknowns that are not at
    a bound; the first summed over the output and the sensors, each with a filter of its own.
    """
    best = min(fits, key=lambda fit: fit.cost)
    filters = [autoregression(pieces) for pieces in by_output(best)]
    values = []
    for fit in fits:
        whites = [whiten(*some) for some in zip(by_output(fit), filters, strict=True)]
        pulled = 1.0 + fit.pulled / max(float(fit.residual @ fit.residual), 1e-300)
        free = len(fit.unknowns) - len(fit.at_bound())
        values.append(sum(len(white) * math.log(max(pulled * float(white @ white), 1e-300)
                                                / len(white)) for white in whites if len(white))
                      + free * math.log(sum(map(len, whites))))
    return values


def gain_p_value(before: Fit, after: Fit, tried: int) -> float:
    """Likelihood-ratio test of what the last effect adds, times the number of effects tried."""
    ratio = sum(likelihood_gain(*some) for some in zip(by_output(before), by_output(after),
                                                       strict=True))
    added = max(1, len(after.unknowns) - len(before.unknowns))
    log_p = float(stats.chi2.logsf(max(ratio, 0.0), added)) + math.log(tried)
    return min(1.0, math.exp(max(log_p, -700.0)))


def likelihood_gain(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Twice the gain of the log-likelihood, residuals whitened by the filter of the latter."""
    filter_ = autoregression(after)
    a, b = (whiten(pieces, filter_) for pieces in (before, after))
    return len(a) * math.log(max(float(a @ a), 1e-300) / max(float(b @ b), 1e-300))


def fit_alternatives(base: Fit, parts: Sequence[Part], times: tuple[float, float], most: int,
                     afresh: bool,
                     progress: Callable[[str], None] = lambda _: None,
                     known: Sequence[Model] = (), most_error: float = math.inf
                     ) -> list[Alternative]:
    """Fit a base with one effect more, for each effect and port; best first.

    A low score does not rule an effect out: the parameters may imitate it at the base's values,
    but not at those of the full fit. An effect that hides in this way is always fitted. And a
    strong effect biases the linear fit so much that no search leads on from there. So a first
    round also starts from the middle of the box and from the fit by the one-step error.

    Args:
        base: the fit without the effect.
        parts: the data to fit.
        times: stamps [s] between which a parameter may drift.
        most: how many effects to fit, by their score, beside those that hide.
        afresh: whether to start with other values of the plant's parameters, too.
        progress: called with what is being fitted.
        known: further starting points, each with one effect more than the base.
        most_error: what leaves more is not searched on, nor refined.
    """
    prospects = screen(base, parts)
    if not afresh and nothing_shows(base, prospects):
        return []
    reach = spans(base.candidate, parts)
    hiding = [Placed(effect, port, tuple(values))
              for effect, port in places(base.candidate.plant, base.candidate.effects)
              if effect.hides for values in effect.starts(reach[port])[:1]]
    near = [with_effect(base.candidate, placed)
            for placed in (*shortlist(prospects, most), *hiding)]
    plain = [*known, *drift_starts(base, parts, times)]
    if afresh:
        plain += nearest(linear_starts(base.candidate, parts), parts)
    return finish(base, race([*plain, *near], parts, progress), parts, most_error)


def race(candidates: Sequence[Model], parts: Sequence[Part],
         progress: Callable[[str], None]) -> list[Fit]:
    """Search from every candidate for a few evaluations, then on from the leading ones.

    Successive halving [Jamieson and Talwalkar 2016], in one step, of the best search of each
    effect at each port. The others stay as they are. What hides may lead only in the end, so it
    always goes on.
    """
    tried = []
    for fit in search_all(candidates, parts, RACING):
        last = fit.candidate.effects[-1]
        progress(f'{last.effect.id} at {last.port.name}')
        tried.append(fit)
    tried = best_at_each_place(tried)
    goes_on = [rank < LEADING or fit.candidate.effects[-1].effect.hides
               for rank, fit in enumerate(tried)]
    further = search_all([fit.candidate for fit in compress(tried, goes_on)], parts,
                         SHORT - RACING)
    return [next(further) if goes else fit for fit, goes in zip(tried, goes_on, strict=True)]


def nothing_shows(base: Fit, prospects: Sequence[Prospect]) -> bool:
    """Whether the residual is white and no effect has a score above chance."""
    most = max((p.share for p in prospects), default=0.0)
    return most * len(base.residual) < PROMISING and is_white(by_part(base))


def with_effect(candidate: Model, placed: Placed) -> Model:
    """Add an effect; a delay takes the place of the timing."""
    return replace(candidate, effects=(*candidate.effects, placed),
                   timing={} if placed.effect.shifts else candidate.timing)


def linear_starts(candidate: Model, parts: Sequence[Part]) -> list[Model]:
    """List linear models to start from: the middle of the box, and fits by the one-step error.

    The missing effect may bias the fit of the free run so much that no search leads back. Where
    the plant integrates, samples at the ends of its travel would make the gain zero, so there is a
    fit to those between, too.
    """
    plant = candidate.plant
    middle = {name: math.exp(0.5 * (low + high)) for name, (low, high) in usual(plant).items()}
    fitted = [parts, between_ends(parts, candidate.sample_time)] if plant.integrates else [parts]
    by_one_step = [one_step_values(plant, some, candidate.values, candidate.sample_time)
                   for some in fitted if some]
    return [replace(candidate, values={**candidate.values, **values}, timing={})
            for values in (middle, *by_one_step) if values is not None]


def drift_starts(base: Fit, parts: Sequence[Part], times: tuple[float, float]
                 ) -> list[Model]:
    """Let each parameter drift at the rate that the residual says, if it says that any does."""
    if not drifts(drift(base, parts)):
        return []
    rates, plant = drifting(base, parts), base.candidate.plant
    return [with_effect(base.candidate, place(effect.id, port.name, {
                'rate': rates[port.name], 'begin': times[0], 'end': times[1]}, plant))
            for effect, port in places(plant, base.candidate.effects, parameters=True)
            if effect.course is not None and rates.get(port.name)]


def with_each(linear: Model, parts: Sequence[Part]) -> list[Model]:
    """Add each effect at each port to a model, from each of its starts."""
    reach = spans(linear, parts)
    return [with_effect(linear, Placed(effect, port, tuple(values)))
            for effect, port in places(linear.plant, linear.effects)
            for values in effect.starts(reach[port])]


def nearest(models: Sequence[Model], parts: Sequence[Part]) -> list[Model]:
    """Add each effect at each port to the model, and from the start, of the lowest error."""
    best: dict[tuple[str, str], tuple[float, Model]] = {}
    for model in models:
        tried = with_each(model, parts)
        states = [start.x for start in initial_states(model, parts)]
        for candidate, misses in zip(
                tried, in_processes(partial(_missed, parts=parts, states=states), tried),
                strict=True):
            last = candidate.effects[-1]
            place = last.effect.id, last.port.name
            if place not in best or misses < best[place][0]:
                best[place] = misses, candidate
    return [candidate for _, candidate in best.values()]


def _missed(candidate: Model, parts: Sequence[Part], states: Sequence[FloatArray]) -> float:
    """RMS of the residual from given initial states, 1e30 where the run diverges."""
    return rms(np.nan_to_num(np.concatenate(residuals_from(candidate, parts, states)), nan=1e30))


def free_run_error(candidate: Model, parts: Sequence[Part]) -> float:
    """RMS of the residual at the present values, 1e30 where the run diverges."""
    return rms(np.nan_to_num(np.concatenate(residuals(candidate, parts)), nan=1e30))


def finish(base: Fit, tried: Sequence[Fit], parts: Sequence[Part],
           most_error: float = math.inf) -> list[Alternative]:
    """Fit the best to convergence, refine their last effects, and rank all of them.

    The law of the best is tried at its other ports, too, from its fit and from the base: the
    search from its own start there may have ended in a local minimum. What leaves more than
    `most_error` after the race stays as it is.
    """
    ranked = best_at_each_place(tried)
    most_error = min(most_error, HOPELESS * ranked[0].error)
    kept = list(takewhile(lambda fit: fit.error <= most_error, ranked[:KEPT]))
    longer = list(search_all([fit.candidate for fit in kept], parts, LONG))
    near = WITHIN * min((fit.error for fit in longer), default=0.0)
    done = refine([fit for fit in longer if fit.error <= near], parts)
    done += [fit for fit in longer if fit.error > near]
    for best in best_at_each_place(done)[:1]:
        moved = relocated(best.candidate, parts)
        moved += [replace(base.candidate, effects=there.effects) for there in moved]
        done += search_all(moved, parts, LONG)
    fits = [fit for fit in best_at_each_place(done + ranked[len(kept):])
            if is_distinguishable(fit, parts)]
    if not fits:
        return []
    scores = criterion(fits)
    order = np.argsort(scores, kind='stable')
    return simplest_first([Alternative(fits[k]) for k in order], [scores[k] for k in order])


def simplest_first(alternatives: list[Alternative], scores: Sequence[float]) -> list[Alternative]:
    """Move the simpler effect to the front, unless the best is clearly better by its BIC.

    Args:
        alternatives: best first.
        scores: their BIC.
    """
    simpler = alternatives[0].placed.effect.simpler
    for k, alternative in enumerate(alternatives):
        if alternative.id == simpler and scores[k] < scores[0] + CLEARLY:
            return [alternative, *alternatives[:k], *alternatives[k + 1:]]
    return alternatives


def best_at_each_place(fits: Sequence[Fit]) -> list[Fit]:
    """Keep the best fit with each last effect at each port, best first."""
    best: dict[tuple[str, str], Fit] = {}
    for fit in sorted(fits, key=lambda fit: fit.cost):
        last = fit.candidate.effects[-1]
        best.setdefault((last.effect.id, last.port.name), fit)
    return list(best.values())


def relocated(candidate: Model, parts: Sequence[Part]) -> list[Model]:
    """Move the last effect to each other port where it can sit, scaled to the signal there."""
    *others, last = candidate.effects
    reach = spans(candidate, parts)
    moved = []
    for effect, port in places(candidate.plant, others, last.effect.course is not None):
        if effect is last.effect and port != last.port:
            ratio = reach[port].value / reach[last.port].value
            values = tuple(v * ratio if p.unit == 'value' else v
                           for p, v in zip(effect.parameters, last.values, strict=True))
            moved.append(replace(candidate, effects=(*others, Placed(effect, port, values))))
    return moved


def refine(fits: Sequence[Fit], parts: Sequence[Part], index: int = -1) -> list[Fit]:
    """Add refinements to the law of an effect, the last or another, where clearly better.

    And remove those that are not: they made up for an effect that was missing at the time. Each
    fit is refined by itself; they are fitted in one batch.
    """
    formed = [_forms(fit, parts, index) for fit in fits]
    short = search_all([form for forms in formed for form in forms], parts, SHORT)
    chosen: list[Fit | Model] = []
    for fit, forms in zip(fits, formed, strict=True):
        tried = [fit, *islice(short, len(forms))]
        simplest = int(bool(forms) and _is_refined(fit, index))
        scores = criterion(tried)
        best = int(np.argmin(scores))
        if scores[best] > scores[simplest] - CLEARLY:
            best = simplest
        chosen.append(fit if best == 0 else tried[best].candidate)
    long = search_all([c for c in chosen if isinstance(c, Model)], parts, LONG)
    return [next(long) if isinstance(c, Model) else c for c in chosen]


def _is_refined(fit: Fit, index: int) -> bool:
    """Whether a refinement of the effect is in."""
    placed = fit.candidate.effects[index]
    return any(p.refinement not in (None, v)
               for p, v in zip(placed.effect.parameters, placed.values, strict=True))


def unrefined(placed: Placed) -> Placed:
    """Return an effect in its simple form, without any refinement."""
    return replace(placed, values=tuple(
        v if p.refinement is None else p.refinement
        for p, v in zip(placed.effect.parameters, placed.values, strict=True)))


def _forms(fit: Fit, parts: Sequence[Part], index: int) -> list[Model]:
    """List other forms of an effect: the simple law, unless it is that, then refined ones."""
    placed = fit.candidate.effects[index]
    if placed.effect.refined is None:
        return []

    def form(values: Sequence[float]) -> Model:
        effects = list(fit.candidate.effects)
        effects[index] = replace(placed, values=tuple(values))
        return replace(fit.candidate, effects=tuple(effects))

    plain = unrefined(placed).values
    reach = spans(fit.candidate, parts)[placed.port]
    simplest = [plain] if _is_refined(fit, index) else []
    return [form(values) for values in (*simplest, *placed.effect.refined(reach, placed.values))]


def is_distinguishable(fit: Fit, parts: Sequence[Part], index: int = -1) -> bool:
    """Whether the recording distinguishes an effect, as fitted, from a simpler one."""
    placed = fit.candidate.effects[index]
    return placed.effect.distinguishable is None or placed.effect.distinguishable(
        spans(fit.candidate, parts)[placed.port], placed.values)


def shortlist(prospects: Sequence[Prospect], most: int) -> list[Placed]:
    """Take the effects of the best scores: two starts for the first few, one for the others."""
    starts: dict[tuple[str, str, str], list[Placed]] = {}
    for prospect in prospects:
        placed = prospect.placed
        starts.setdefault((placed.effect.id, placed.port.name, placed.port.kind), []).append(
            placed)
    return [placed for rank, some in enumerate(starts.values())
            for placed in some[:2 if rank < AGAIN else 1]
            if rank < most or placed.effect.hides]
