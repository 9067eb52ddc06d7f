"""What a model lacks: named effects and a free curve, by the likelihood of what they leave.

A plant that integrates accumulates disturbances, as the timing error of commands within a sample.
Its residual is then a random walk, whose low frequencies dominate the sum of squares: a dead zone
hardly differs from an offset. So where the residual of a first search is coloured, it is taken as
noise, and a second search maximises the likelihood: on parts with filters that whiten it.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import sys
from typing import NamedTuple

from hydro_twin.fitting.coloured import as_measured, is_coloured, whitened
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.beam import beam_search, may_be_extended
from hydro_twin.inference.context import Context, effects_of
from hydro_twin.inference.continuation import from_short_windows, with_rivals_of_short_windows
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.curve import FittedCurve, outweighs
from hydro_twin.inference.curve_or_names import with_curve
from hydro_twin.inference.findings import explained_share, other_findings, Selection
from hydro_twin.inference.held_out import held_out_gain
from hydro_twin.inference.noise import cannot_be_noise
from hydro_twin.inference.search import LONG, search, search_sticking
from hydro_twin.inference.select import Alternative, fit_alternatives
from hydro_twin.inference.stepwise import (
    best_timing,
    exchange,
    FINEST,
    is_discretisation_error,
    is_residual_structured,
    LATER,
    MIN_EXPLAINED_SHARE,
    MOST_EFFECTS,
    refined,
    select_forward,
    with_fine_steps,
    without_indistinct,
    without_unsupported,
)
from hydro_twin.inference.validation import validated
from hydro_twin.model import Model

ALL = sys.maxsize       # effects fitted in full in the first round
LAST = 60               # evaluations of the final search, which starts at a converged fit


class Explanation(NamedTuple):
    """What a model lacks.

    Attributes:
        base: the model without it, fitted no worse than from the first effect.
        selection: the model with the named effects.
        curve: a curve without a name on top of that, if one helps.
        replaced: the named effects whose place it took, if it did.
    """

    base: Fit
    selection: Selection
    curve: FittedCurve | None
    replaced: Selection | None

    @property
    def fit(self) -> Fit:
        """The model with all that was found."""
        return self.selection.fit if self.curve is None else self.curve.fit


def explain(base: Fit, context: Context, known: Sequence[Model]) -> Explanation:
    """Search for what a model lacks.

    Args:
        base: the model.
        context: the data.
        known: models with one effect more, to start from.
    """
    known = [*known, *from_short_windows(base, context)]
    base, named, _ = _selected(base, context, known)
    selection = _supported(named, base, context)
    if is_discretisation_error(selection.fit, context.parts):
        return Explanation(base, selection, None, None)
    found = None
    if is_coloured(selection.fit):
        context.progress('searching with coloured noise')
        found = _by_likelihood(base, selection, context)
    if found is None:
        context.progress('trying free curves')
        found = Explanation(base, *with_curve(selection, base, context))
        if found.curve is not None and len(selection.findings) < len(named.findings):
            found = _against_unsupported(found, named, context)
    return found._replace(selection=with_rivals_of_short_windows(found.selection, context))


def _against_unsupported(found: Explanation, named: Selection, context: Context) -> Explanation:
    """Weigh a curve against the names that were dropped since each explains too little.

    Where no curve, of any signal at any port, outweighs them, they are no worse than any static
    law that is not in the library.
    """
    assert found.curve is not None
    if outweighs(found.curve.fit, named.fit, context.held_out):
        return found._replace(replaced=found.replaced or named)
    kept, effects = effects_of(found.selection.fit.candidate), named.fit.candidate.effects
    return found._replace(curve=None, replaced=None, selection=replace(named, findings=tuple(
        replace(one, supported=effects[one.index].key in kept)
        for one in named.findings)))


def _by_likelihood(base: Fit, selection: Selection, context: Context) -> Explanation | None:
    """Repeat a search by the likelihood of what it left.

    Args:
        base: the model.
        selection: what was found by least squares.
        context: the data.

    Returns:
        What is found now; None where that is the same effects, but for linear dynamics, or not
        surely better on held-out data, by this likelihood or by the run itself, or no better by
        the run.
    """
    parts = context.parts
    white = replace(context, parts=whitened(parts, selection.fit),
                    held_out=whitened(context.held_out, selection.fit), known={}, fits={})
    there, again = _found_by_likelihood(
        search(base.candidate, white.parts, LONG), selection, white)
    again = _without_weak_dynamics(again, white, context)
    context.progress('trying free curves')
    again, found, replaced = with_curve(again, there, white)
    last = again.fit if found is None else found.fit
    if _ids(last) == _ids(selection.fit):
        return None
    again = _as_measured(again, parts) if again.findings else Selection(base)
    explained = Explanation(base, again, None, None)
    if found is not None:
        found = replace(found, fit=as_measured(found.fit, parts))
        named = replaced and _as_measured(replaced, parts)
        helps = held_out_gain((named or again).fit, found.fit, context.held_out, context.seed)
        explained = (Explanation(base, again, replace(found, gain=helps), named)
                     if helps.relative > 0.0 else
                     Explanation(base, named or again, None, None))
    # Innovations may be explained at the cost of the run, where no laws are exactly right.
    helps = held_out_gain(selection.fit, explained.fit, context.held_out, context.seed)
    if helps.low > 0.0:
        return explained
    if not helps.relative > 0.0:
        return None
    first = search(selection.fit.candidate, white.parts, LONG)
    helps = held_out_gain(first, last, white.held_out, context.seed)
    return explained if helps.low > 0.0 else None


def _found_by_likelihood(base: Fit, selection: Selection, white: Context
                         ) -> tuple[Fit, Selection]:
    """Search whitened data from what least squares found.

    Where the two criteria agree on the effects, or these leave no structure, that is all. A search
    from several models, which takes most of the time of a trace, is for the other recordings.

    Returns:
        The base, fitted no worse, and what was found.
    """
    given = base.candidate.effects
    known = [replace(base.candidate, values=selection.fit.candidate.values,
                     effects=(*given, placed))
             for placed in selection.fit.candidate.effects[len(given):]]
    if known:
        found = _improved(selection, base, white)
        agreed = _ids(found.fit) == _ids(selection.fit)
        if agreed or not may_be_extended(found, white):
            return base, found
        alternatives = _first_alternatives(base, white, known)
    else:
        base, found, alternatives = _selected(base, white, known)
        found = _supported(found, base, white)
    base = white.best(base)
    wider = beam_search(found, base, alternatives, white)
    return base, (found if wider is found else
                  _supported(_finalised(wider, white), base, white))


def _improved(selection: Selection, base: Fit, white: Context) -> Selection:
    """Replace or drop effects that least squares found, by likelihood, and add further ones."""
    fit = search(selection.fit.candidate, white.parts, LONG)
    better = exchange(replace(selection, fit=fit), white, last=True)
    if 0 < len(better.findings) < MOST_EFFECTS:
        better = select_forward(better, white.fit_alternatives(better.fit, LATER), white)
    better = _without_needless(better, white)
    return _supported(_finalised(validated(better, base, white), white), base, white)


def _without_needless(selection: Selection, context: Context) -> Selection:
    """Drop each effect whose place a refinement of another takes, as the middle of a dead zone.

    An offset that least squares took for such a zone stays beside it otherwise.
    """
    for k, found in enumerate(selection.findings if len(selection.findings) > 1 else ()):
        (without,) = context.without(selection.fit, [found.index])
        rest = other_findings(selection, k)
        other = refined(Selection(without, rest), rest, context)
        with_it, bare = delta_bic([selection.fit, other.fit])
        if bare < with_it + CLEAR_DELTA_BIC:
            return _without_needless(other, context)
    return selection


def _without_weak_dynamics(selection: Selection, white: Context, context: Context) -> Selection:
    """Drop each delay, lag or mode that explains too little of the run itself.

    That is less than `MIN_EXPLAINED_SHARE`.

    Args:
        selection: what was found by likelihood.
        white: the whitened data.
        context: the data as measured.
    """
    dynamic = [k for k, index in enumerate(selection.indices)
               if selection.fit.candidate.effects[index].effect.dynamic]
    if not dynamic:
        return selection
    fit = search(selection.fit.candidate, context.parts, LONG)
    if not (cannot_be_noise(fit.by_part)
            and is_residual_structured(replace(selection, fit=fit), context)):
        return selection
    for k in dynamic:
        index = selection.findings[k].index
        (bare,) = context.without(fit, [index])
        if explained_share(bare, fit) < MIN_EXPLAINED_SHARE:
            (rest,) = white.without(selection.fit, [index])
            return _without_weak_dynamics(
                Selection(rest, other_findings(selection, k)), white, context)
    return selection


def _ids(fit: Fit) -> list[str]:
    """Name the effects of a model, at whatever ports, but for linear dynamics.

    Innovations show a lag or a mode best, and the run hardly.
    """
    return sorted(placed.effect.id for placed in fit.candidate.effects
                  if not placed.effect.dynamic)


def _as_measured(selection: Selection, parts: Sequence[Part]) -> Selection:
    """Take a selection that was fitted to whitened parts to the parts as they are."""
    return replace(selection, fit=as_measured(selection.fit, parts))


def _selected(base: Fit, context: Context, known: Sequence[Model]
              ) -> tuple[Fit, Selection, list[Alternative]]:
    """Add effects to a model one after another.

    Returns:
        The base, fitted no worse than from the first effect; what passed all tests; and the first
        alternatives.
    """
    alternatives = _first_alternatives(base, context, known)
    grown = select_forward(Selection(base), alternatives, context)
    base = context.best(base)
    return base, _finalised(validated(grown, base, context), context), alternatives


def _first_alternatives(base: Fit, context: Context, known: Sequence[Model]
                        ) -> list[Alternative]:
    """Fit each effect on top of the base, from many starts."""
    alternatives = fit_alternatives(base, context.parts, context.times, ALL, afresh=True,
                                    progress=context.progress, known=known)
    context.remember(*(alternative.fit for alternative in alternatives))
    return alternatives


def _finalised(selection: Selection, context: Context) -> Selection:
    """Fit a selection with steps that are fine enough.

    A search that goes further may end where an effect is no longer distinguished from a simpler
    one.
    """
    if not selection.findings:
        return selection
    fine = with_fine_steps(selection.fit, context.parts, FINEST)
    better = search(fine.candidate, context.parts, LAST)
    better = best_timing(better, context.parts)
    better = search_sticking(better, context.parts)
    return without_indistinct(replace(selection, fit=better), context)


def _supported(selection: Selection, base: Fit, context: Context) -> Selection:
    """Drop what explains too little; the same selection, if nothing does."""
    kept = without_unsupported(selection, base, context)
    return kept if kept.findings else Selection(base)
