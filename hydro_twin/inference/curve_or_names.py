"""A free curve or named effects: a curve beside them, in their place, or decomposed into some."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import P_PREDICTED, predicted_by_ports
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.inference.context import Context
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.curve import (
    explains_most,
    find_curve,
    FittedCurve,
    has_equivalent_law,
    is_better,
    outweighs,
)
from hydro_twin.inference.decomposition import decompositions
from hydro_twin.inference.findings import explained_share, finding, other_findings, Selection
from hydro_twin.inference.held_out import held_out_gain, residuals
from hydro_twin.inference.search import LONG, search, search_all
from hydro_twin.inference.select import HOPELESS
from hydro_twin.inference.stepwise import MIN_EXPLAINED_SHARE
from hydro_twin.inference.structure import free_curves, is_moving_offset, is_significant_dependence
from hydro_twin.predictors.scores import rms
from hydro_twin.result import BestNamed, Dependence


def best_named(selection: Selection, held_out: Sequence[Part]) -> BestNamed:
    """Describe the named effects that a free curve took the place of."""
    return BestNamed(tuple(selection.fit.candidate.effects[k] for k in selection.indices),
                     rms(np.concatenate(residuals(selection.fit, held_out))))


def with_curve(selection: Selection, base: Fit, context: Context
               ) -> tuple[Selection, FittedCurve | None, Selection | None]:
    """Look for a free curve beside the named effects, or instead of them.

    Several named effects often imitate one law that has no name, or an offset that moves with
    time, which none of these curves can show.

    Args:
        selection: the model with the named effects.
        base: the fit without any of them.
        context: the data.

    Returns:
        The selection, or one without some or all of its effects; the curve on top of it, if one
        helps; and the selection with these effects, if it took their place.
    """
    parts, held_out, seed = context.parts, context.held_out, context.seed
    if is_moving_offset(base, selection.fit, parts):
        return Selection(base), None, None
    curves = free_curves(selection.fit, parts)
    at_first = curves if selection.fit is base else free_curves(base, parts)
    if selection.findings and _contested(selection, parts, curves, at_first):
        instead = find_curve(base, parts, held_out, at_first, seed, HOPELESS * selection.fit.error)
        if instead and is_better(instead, base, selection.fit, at_first, held_out):
            laws = decompose_curve(Selection(base), instead, base, context)
            return (laws, None, None) if laws else (Selection(base), instead, selection)
    found = find_curve(selection.fit, parts, held_out, curves, seed)
    if not found:
        return selection, None, None
    laws = decompose_curve(selection, found, base, context)
    if laws:
        return laws, None, None
    kept, found = _without_needless(selection, found, context)
    return kept, found, selection if kept is not selection else None


def decompose_curve(selection: Selection, found: FittedCurve, base: Fit, context: Context
                    ) -> Selection | None:
    """Put named laws in the place of a curve, if they do as well as it does.

    Args:
        selection: the model without the curve.
        found: the curve.
        base: the fit without any effect.
        context: the data.

    Returns:
        The model with the laws, each of which explains half of what is left without it, and
        improves held-out data; None where there are no such laws, or the curve outweighs them all.
    """
    held_out = context.held_out
    tried = list(search_all(
        decompositions(found.fit.candidate, context.parts), context.parts, LONG))
    scores = delta_bic(tried) if tried else []
    for fit in (tried[k] for k in np.argsort(scores, kind='stable')):
        if outweighs(found.fit, fit, held_out):
            continue
        laws = range(len(selection.fit.candidate.effects), len(fit.candidate.effects))
        bare = ([base] if len(laws) == len(fit.candidate.effects) == 1 else
                context.without(fit, laws))
        if all(explained_share(without, fit) > MIN_EXPLAINED_SHARE
               and held_out_gain(without, fit, held_out, context.seed).low > 0.0
               for without in bare):
            return Selection(fit, (*selection.findings, *(
                finding(without, fit, _in_place_of(k, fit, tried), k)
                for k, without in zip(laws, bare, strict=True))))
    return None


def _in_place_of(index: int, fit: Fit, tried: Sequence[Fit]) -> list[tuple[Placed, Fit]]:
    """List the laws that other decompositions have in the place of one of the best, with each."""
    ids = {placed.effect.id for placed in fit.candidate.effects}
    mine = fit.candidate.effects[index].effect.id
    rivals = []
    for other in tried:
        theirs = {placed.effect.id: placed for placed in other.candidate.effects}
        instead = [placed for name, placed in theirs.items() if name not in ids]
        if mine not in theirs and instead:
            rivals.append((instead[0], other))
    return rivals


def _contested(selection: Selection, parts: Sequence[Part], curves: Sequence[Dependence],
               at_first: Sequence[Dependence]) -> bool:
    """Whether a curve may explain the residual without the named effects.

    The named effects may leave structure; or it took one effect at two ports; or one curve, at
    another port or signal, explains most of the first residual.
    """
    ids = [selection.fit.candidate.effects[k].effect.id for k in selection.indices]
    if (any(is_significant_dependence(curve) for curve in curves) or len(set(ids)) < len(ids)
            or not is_white(selection.fit.by_part)
            or predicted_by_ports(selection.fit, parts)[1] < P_PREDICTED):
        return True
    return any(curve.share > MIN_EXPLAINED_SHARE and not has_equivalent_law(
        (curve.port, curve.signal), selection.fit, at_first) for curve in at_first[:1])


def _without_needless(selection: Selection, found: FittedCurve, context: Context
                      ) -> tuple[Selection, FittedCurve]:
    """Withdraw named effects that the curve contains, as a bias that is its constant part.

    The least helpful first. But not where the curve does not outweigh the names, or where the
    effect explains by itself most of what the curve would in its place, which then only describes
    it more finely.
    """
    bare = context.without(selection.fit, selection.indices)
    for k in sorted(range(len(bare)), key=lambda k: bare[k].error):
        without, index = bare[k], selection.findings[k].index
        instead = search(found.fit.candidate.without(index), context.parts, LONG)
        with_it, without_it = delta_bic([found.fit, instead])
        if (without_it < with_it + CLEAR_DELTA_BIC
                and not explains_most(without, selection.fit, instead)
                and outweighs(instead, selection.fit, context.held_out)):
            helps = held_out_gain(without, instead, context.held_out, context.seed)
            return _without_needless(Selection(without, other_findings(selection, k)),
                                     replace(found, fit=instead, gain=helps), context)
    return selection, found
