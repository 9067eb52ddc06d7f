"""Validation of the selected effects on held-out data, and other laws in their places."""
from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from hydro_twin.effects import Placed
from hydro_twin.fitting.autoregression import effective_samples
from hydro_twin.fitting.fit import Fit
from hydro_twin.inference.context import Context
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.decomposition import equivalents
from hydro_twin.inference.findings import finding, other_findings, Selection, share
from hydro_twin.inference.held_out import (
    held_out_gain,
    p_of_no_gain,
    residuals,
    surer_improvement,
)
from hydro_twin.inference.limits import without_unreached
from hydro_twin.inference.search import LONG, search_all
from hydro_twin.inference.starts import with_other
from hydro_twin.inference.stepwise import (
    exchange,
    indistinct,
    LATER,
    MIN_SHARE_LATER,
    MOST_EFFECTS,
    refined,
    select_forward,
    without_indistinct,
)
from hydro_twin.result import AMBIGUOUS_DELTA_BIC

UNPROVEN = 0.15         # probability that it does not help up to which an effect stays beside
#                         others: on the recordings that it was set by, those that are there had
#                         at most 0.12, those that are not at least 0.2


def validated(selection: Selection, base: Fit, context: Context) -> Selection:
    """Keep the effects that held-out data confirm, and find their rivals.

    Args:
        selection: a model that has grown.
        base: the fit without any of its effects.
        context: the data.
    """
    selection = _without_unproven(selection, base, context)
    selection = without_indistinct(refined(selection, selection.findings, context), context)
    return _without_refuted(_with_equivalents(selection, context), context)


def _with_equivalents(selection: Selection, context: Context) -> Selection:
    """Fit laws that draw the same curve in the place of each static one: they are rivals.

    Those that were fitted when it was chosen have not been refined since. A simpler one is
    preferred unless it is clearly worse.
    """
    for k, found in enumerate(selection.findings):
        models = equivalents(selection.fit.candidate, found.index, context.parts)
        if not models:
            continue
        fits = [selection.fit, *search_all(models, context.parts, LONG)]
        laws = [fit.candidate.effects[found.index] for fit in fits]
        scores = delta_bic(fits)
        near = [j for j, score in enumerate(scores) if score < min(scores) + CLEAR_DELTA_BIC]
        best = next((j for j in near if laws[j].effect.id == laws[0].effect.simpler), near[0])
        (without,) = context.without(fits[best], [found.index])
        again = finding(without, fits[best], [
            (law, fit) for j, (law, fit) in enumerate(zip(laws, fits, strict=True)) if j != best],
            found.index)
        fitted = {(law.effect, law.port) for law in laws}
        others = [one for one in found.rivals if (one[0].effect, one[0].port) not in fitted]
        again = replace(again, doubt=found.doubt, rivals=tuple(sorted(
            (*again.rivals, *others), key=lambda rival: rival[1])))
        findings = (*selection.findings[:k], again, *selection.findings[k + 1:])
        selection = Selection(fits[best], findings)
        context.remember(selection.fit)
    return selection


def _without_unproven(selection: Selection, without: Fit, context: Context,
                      refuted: frozenset[str] = frozenset()) -> Selection:
    """Drop the effects that do not improve held-out data, the least helpful first.

    One that does not, see `_on_held_out`, is replaced by a close rival on the training data, if
    that improves held-out data. If without it another effect degenerates to a simpler law, as a
    hysteresis that is never crossed and so is a constant of each window, the other is dropped, if
    it fails, too; else both stay. A limit that the training data never reach is taken off first:
    held-out data may go beyond it.

    Forward selection then continues from the remaining effects: beside a spurious effect, as a
    drift in a series of ever larger steps, the right one may not have been found.

    Args:
        selection: a model that has grown.
        without: the fit without any of its effects.
        context: the data.
        refuted: ids of effects that were dropped before.
    """
    if not selection.findings:
        return selection
    selection = replace(selection, fit=without_unreached(selection.fit, context.parts))
    context.progress('testing each effect on held-out data')
    bare = context.without(selection.fit, selection.indices)
    if len(bare) == 1:
        bare = [min(bare[0], without, key=lambda fit: fit.cost)]
    gains, doubts = _on_held_out(selection.fit, bare, without, context)
    fails = {k for k, doubted in enumerate(doubts) if doubted is None}
    replaced_by = {k: _simpler_without(selection, k, bare[k], context) for k in fails}
    fails -= {k for k, others in replaced_by.items() if others and not others <= fails}
    if not fails:
        return replace(selection, findings=tuple(
            replace(found, doubt=doubted or 0.0)
            for found, doubted in zip(selection.findings, doubts, strict=True)))
    least = min(fails, key=lambda k: gains[k])
    if instead := _unrefuted(selection, least, bare[least], context):
        return _without_unproven(instead, without, context, refuted)
    least = min(replaced_by[least], default=least)
    # What stood beside the others need not be the best by itself.
    chosen = exchange(Selection(bare[least], other_findings(selection, least)), context, last=True)
    dropped = selection.fit.candidate.effects[selection.findings[least].index].effect.id
    if chosen.findings and dropped not in refuted and len(refuted) < MOST_EFFECTS:
        refuted |= {dropped}
        alternatives = context.fit_alternatives(chosen.fit, LATER)
        chosen = select_forward(chosen, alternatives, context, refuted)
    return _without_unproven(chosen, without, context, refuted)


def _on_held_out(fit: Fit, bare: Sequence[Fit], without: Fit, context: Context
                 ) -> tuple[list[float], list[float | None]]:
    """Say how well each effect does on held-out data.

    One is proven if the whole interval of the improvement is above zero. Short held-out data may
    not prove each of several, as a dead zone with a limit behind it. So where all together surely
    help, `UNPROVEN` is enough for one that explains much of the training data.

    Args:
        fit: with all effects.
        bare: without each.
        without: without any.
        context: the data.

    Returns:
        The least that each improves them by, surely; and the probability that it does not, 0 if it
        is proven, None if that is too large.
    """
    left, *before = (residuals(one, context.held_out) for one in (without, *bare))
    after, seed = residuals(fit, context.held_out), context.seed
    gains = [surer_improvement(one, after, seed).low for one in before]
    together = surer_improvement(left, after, seed).low > 0.0
    doubts: list[float | None] = []
    for one, gain, alone in zip(before, gains, bare, strict=True):
        doubted = 0.0 if gain > 0.0 else p_of_no_gain(one, after, seed)
        stays = gain > 0.0 or (together and doubted <= UNPROVEN
                               and share(alone, fit) > MIN_SHARE_LATER)
        doubts.append(doubted if stays else None)
    return gains, doubts


def _simpler_without(selection: Selection, k: int, without: Fit, context: Context) -> set[int]:
    """Say which of the others are no longer distinguished from simpler laws without an effect."""
    return {j + (j >= k) for j in indistinct(without, context.parts, other_findings(selection, k))}


def _unrefuted(selection: Selection, k: int, without: Fit, context: Context) -> Selection | None:
    """Put a close rival in the place of an effect that does not improve held-out data.

    Args:
        selection: a model that has grown.
        k: which of its findings fails.
        without: the fit without that.
        context: the data.

    Returns:
        The model with the first close rival that improves held-out data; None if none does. Those
        that do not are no longer rivals.
    """
    found = selection.findings[k]
    for tries, ((_, distance), fit) in enumerate(_close_rivals(selection, k, context), 1):
        if held_out_gain(without, fit, context.held_out, context.seed).low > 0.0:
            return _instead(selection, k, fit, without, distance, found.rivals[tries:])
    return None


def _instead(selection: Selection, k: int, fit: Fit, without: Fit, distance: float,
             rivals: Sequence[tuple[Placed, float]]) -> Selection:
    """Take a rival in the place of an effect.

    Args:
        selection: a model that has grown.
        k: which of its findings gives way.
        fit: with the rival.
        without: the fit without either.
        distance: of the rival from the effect.
        rivals: those that are left, with their distances from the effect.
    """
    others = sorted(((placed, abs(d - distance)) for placed, d in rivals), key=lambda one: one[1])
    found = replace(finding(without, fit, (), selection.findings[k].index), rivals=tuple(others))
    return Selection(fit, (*selection.findings[:k], found, *selection.findings[k + 1:]))


def _without_refuted(selection: Selection, context: Context) -> Selection:
    """Drop close rivals that held-out data refute, surely and as clearly as training data would.

    A stop and a limit behind which the state winds up differ only in how they are left, which the
    training data may not show. An offset here or there differs by a ten-thousandth, which may be
    sure and says nothing. Where the effect itself is refuted by a rival, that takes its place.
    """
    if not selection.findings:
        return selection
    after, kept = residuals(selection.fit, context.held_out), []
    least = CLEAR_DELTA_BIC / effective_samples(after)
    for k, found in enumerate(selection.findings):
        refuted = []
        for rival, fit in _close_rivals(selection, k, context):
            left = residuals(fit, context.held_out)
            if surer_improvement(left, after, context.seed).low > least:
                refuted.append(rival)
            elif surer_improvement(after, left, context.seed).low > least:
                (without,) = context.without(selection.fit, [found.index])
                others = [one for one in found.rivals if one != rival]
                instead = _instead(selection, k, fit, without, rival[1], others)
                return _without_refuted(instead, context)
        kept.append(replace(found, rivals=tuple(
            rival for rival in found.rivals if rival not in refuted)))
    return replace(selection, findings=tuple(kept))


def _close_rivals(selection: Selection, k: int, context: Context
                  ) -> Iterator[tuple[tuple[Placed, float], Fit]]:
    """Fit each close rival in the place of an effect."""
    found, candidate = selection.findings[k], selection.fit.candidate
    close = [rival for rival in found.rivals if rival[1] < AMBIGUOUS_DELTA_BIC]
    fits = search_all([with_other(candidate, found.index, placed) for placed, _ in close],
                      context.parts, LONG)
    return zip(close, (without_unreached(fit, context.parts) for fit in fits), strict=True)
