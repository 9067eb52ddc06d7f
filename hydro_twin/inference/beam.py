"""Beam search, where forward selection leaves structure in the residual.

Two laws that act together may each explain less than a third that imitates them: an eccentric
dead zone with a limit behind it looks like an offset. Forward selection takes the offset, and the
residual then points to other effects.
"""
from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hydro_twin.fitting.fit import Fit
from hydro_twin.inference.context import Context
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.findings import finding, Selection, share
from hydro_twin.inference.refinement import refine
from hydro_twin.inference.select import Alternative, HOPELESS
from hydro_twin.inference.stepwise import (
    AGAIN,
    exchange,
    is_residual_structured,
    is_significant,
    MIN_SHARE,
    MOST_EFFECTS,
    RIVALS,
)
from hydro_twin.inference.validation import validated

WIDTH = 3               # models that go on
DEEPER = 1              # effects in a model beyond those that are kept: one more may make an
#                         earlier one needless


def beam_search(selection: Selection, base: Fit, alternatives: Sequence[Alternative],
                context: Context) -> Selection:
    """Search for a model that is clearly better than a selection that leaves structure.

    From the best first effects on, each of the best models is extended by each of the best
    effects beside it, effects that have become needless are dropped, and the best go on. Models
    are compared by their BIC.

    Args:
        selection: what forward selection found.
        base: the fit without any effect.
        alternatives: fits with one, best first.
        context: the data.
    """
    if not alternatives or not may_be_extended(selection, context):
        return selection
    given = len(base.candidate.effects)
    seen: dict[frozenset[str], Fit] = {}
    beam = _best(_promising(base, alternatives, selection), seen)
    for _ in range(MOST_EFFECTS + DEEPER - 1):
        seen |= {_kinds(fit): fit for fit in beam}
        extended = [one for fit in beam for one in _promising(
            fit, context.fit_alternatives(fit, AGAIN, _most(fit, selection)), selection)]
        beam = _best((_without_needless(fit, given, context)
                      for fit in _best(extended, seen)), seen)
    seen |= {_kinds(fit): fit for fit in beam}
    whole = [fit for fit in seen.values() if len(fit.candidate.effects) <= given + MOST_EFFECTS]
    if not whole:
        return selection
    first, *scores = delta_bic([selection.fit, *whole])
    best = whole[int(np.argmin(scores))]
    if not min(scores) < first - CLEAR_DELTA_BIC:
        return selection
    context.remember(*whole)
    indices = range(given, len(best.candidate.effects))
    found = tuple(finding(without, best, (), index) for index, without in zip(
        indices, context.without(best, indices), strict=True))
    other = validated(exchange(Selection(best, found), context, last=True), base, context)
    one, two = delta_bic([selection.fit, other.fit])
    return other if two < one - CLEAR_DELTA_BIC else selection


def may_be_extended(selection: Selection, context: Context) -> bool:
    """Whether a selection leaves structure, and has fewer effects than a model may have.

    With as many it stays: on the development rigs none of those was replaced, and the search took
    up to half of the time.
    """
    return (len(selection.findings) < MOST_EFFECTS
            and is_residual_structured(selection, context))


def _promising(fit: Fit, alternatives: Sequence[Alternative], selection: Selection) -> list[Fit]:
    """Take the significant alternatives to a fit that may lead to a rival of a selection."""
    return [one.fit for one in alternatives
            if is_significant(fit, one.fit, MIN_SHARE)
            and one.fit.error < HOPELESS * selection.fit.error]


def _most(fit: Fit, selection: Selection) -> float:
    """Return the error beyond which an extension of a model is no rival to a selection.

    An extension with no more effects than the selection may still match it with one more.
    """
    larger = len(fit.candidate.effects) >= len(selection.fit.candidate.effects)
    return (RIVALS if larger else HOPELESS) * selection.fit.error


def _kinds(fit: Fit) -> frozenset[str]:
    """Name the effects of a model, at whatever ports: those at others hardly differ."""
    return frozenset(placed.effect.id for placed in fit.candidate.effects)


def _best(fits: Iterable[Fit], seen: dict[frozenset[str], Fit]) -> list[Fit]:
    """Keep the best models that are not seen yet, of each set of effects the best one."""
    best: dict[frozenset[str], Fit] = {}
    for fit in sorted(fits, key=lambda one: one.cost):
        if _kinds(fit) not in seen:
            best.setdefault(_kinds(fit), fit)
    some = list(best.values())
    scores = delta_bic(some) if some else []
    return [some[k] for k in np.argsort(scores, kind='stable')[:WIDTH]]


def _without_needless(fit: Fit, given: int, context: Context) -> Fit:
    """Drop each effect without which the BIC is hardly larger, as an offset beside a dead zone.

    What is left is refined for that: the middle of the zone takes the place of the offset.
    """
    indices = range(given, len(fit.candidate.effects) - 1)
    for without in context.without(fit, indices):
        for index in range(given, len(without.candidate.effects)):
            without, = refine([without], context.parts, index)
        with_it, bare = delta_bic([fit, without])
        if bare < with_it + CLEAR_DELTA_BIC or share(without, fit) < MIN_SHARE:
            return _without_needless(without, given, context)
    return fit
