"""What stays of a model that has grown, by held-out data, and what else may be in its place."""
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from hydro_twin.effects import Placed
from hydro_twin.fitting.autoregression import effective_samples
from hydro_twin.fitting.fit import Fit
from hydro_twin.inference.chain import exchange, indistinct, refined, simplified
from hydro_twin.inference.context import Context
from hydro_twin.inference.criterion import CLEARLY, criterion
from hydro_twin.inference.findings import Chain, finding, other_findings
from hydro_twin.inference.proof import proof, residuals, surer_improvement
from hydro_twin.inference.reading import equivalents
from hydro_twin.inference.select import LONG, search_all
from hydro_twin.result import CLOSE


def settled(chain: Chain, base: Fit, context: Context) -> Chain:
    """Keep of a model what held-out data bear out, and see what else could be in its place.

    Args:
        chain: a model that has grown.
        base: the fit without any of its effects.
        context: the data.
    """
    chain = _proven(chain, base, context)
    chain = simplified(refined(chain, chain.findings, context), context)
    return _without_refuted(_with_equivalents(chain, context), context)


def _with_equivalents(chain: Chain, context: Context) -> Chain:
    """Fit laws that draw the same curve in the place of each static one: they are rivals.

    Those that were fitted when it was chosen have not been refined since. A simpler one is
    preferred unless it is clearly worse.
    """
    for k, found in enumerate(chain.findings):
        models = equivalents(chain.fit.candidate, found.index, context.parts)
        if not models:
            continue
        fits = [chain.fit, *search_all(models, context.parts, LONG)]
        laws = [fit.candidate.effects[found.index] for fit in fits]
        scores = criterion(fits)
        near = [j for j, score in enumerate(scores) if score < min(scores) + CLEARLY]
        best = next((j for j in near if laws[j].effect.id == laws[0].effect.simpler), near[0])
        (without,) = context.without(fits[best], [found.index])
        again = finding(without, fits[best], [
            (law, fit) for j, (law, fit) in enumerate(zip(laws, fits, strict=True)) if j != best],
            found.index)
        fitted = {(law.effect, law.port) for law in laws}
        others = [one for one in found.rivals if (one[0].effect, one[0].port) not in fitted]
        again = replace(again, rivals=tuple(sorted(
            (*again.rivals, *others), key=lambda rival: rival[1])))
        chain = Chain(fits[best], (*chain.findings[:k], again, *chain.findings[k + 1:]))
        context.remember(chain.fit)
    return chain


def _proven(chain: Chain, without: Fit, context: Context) -> Chain:
    """Drop the effects that do not improve held-out data, the least helpful first.

    An effect helps if the whole interval of the improvement is above zero. One that does not
    gives way to an effect that the training data hardly tell from it, if that helps. Where one
    could only be left out because another took its place as a simpler law, as a hysteresis that
    is never crossed and so is a constant of each window, the other is dropped, if it fails, too;
    else both stay.

    Short held-out data may not prove each of two effects without the other, as a dead zone with a
    limit behind it. Where none would be left, those stay that surely help together, if each is
    more likely to help than not.

    Args:
        chain: a model that has grown.
        without: the fit without any of its effects.
        context: the data.
    """
    if not chain.findings:
        return chain
    bare = context.without(chain.fit, chain.indices)
    if len(bare) == 1:
        bare = [min(bare[0], without, key=lambda fit: fit.cost)]
    after = residuals(chain.fit, context.held_out)
    gains = [surer_improvement(residuals(fit, context.held_out), after, context.seed)
             for fit in bare]
    fails = {k for k, gain in enumerate(gains) if not gain.low > 0.0}
    replaced_by = {k: _simpler_without(chain, k, bare[k], context) for k in fails}
    fails -= {k for k, others in replaced_by.items() if others and not others <= fails}
    if not fails:
        return chain
    least = min(fails, key=lambda k: gains[k].low)
    if instead := _unrefuted(chain, least, bare[least], context):
        return _proven(instead, without, context)
    least = min(replaced_by[least], default=least)
    # What stood beside the others need not be the best by itself.
    chosen = exchange(Chain(bare[least], other_findings(chain, least)), context, last=True)
    smaller = _proven(chosen, without, context)
    if smaller.findings or len(gains) < 2 or not all(gain.relative > 0.0 for gain in gains):
        return smaller
    before = residuals(without, context.held_out)
    return chain if surer_improvement(before, after, context.seed).low > 0.0 else smaller


def _simpler_without(chain: Chain, k: int, without: Fit, context: Context) -> set[int]:
    """Say which of the others are no longer distinguished from simpler laws without an effect."""
    return {j + (j >= k) for j in indistinct(without, context.parts, other_findings(chain, k))}


def _unrefuted(chain: Chain, k: int, without: Fit, context: Context) -> Chain | None:
    """Put a close rival in the place of an effect that does not improve held-out data.

    Args:
        chain: a model that has grown.
        k: which of its findings fails.
        without: the fit without that.
        context: the data.

    Returns:
        The model with the first close rival that improves held-out data; None if none does. Those
        that do not are no longer rivals.
    """
    found = chain.findings[k]
    for tries, ((_, distance), fit) in enumerate(_close_rivals(chain, k, context), 1):
        if proof(without, fit, context.held_out, context.seed).low > 0.0:
            instead = replace(
                finding(without, fit, (), found.index),
                rivals=tuple((placed, d - distance) for placed, d in found.rivals[tries:]))
            return Chain(fit, (*chain.findings[:k], instead, *chain.findings[k + 1:]))
    return None


def _without_refuted(chain: Chain, context: Context) -> Chain:
    """Drop close rivals that held-out data refute, surely and as clearly as training data would.

    A stop and a limit behind which the state winds up differ only in how they are left, which the
    training data may not show. An offset here or there differs by a ten-thousandth, which may be
    sure and says nothing.
    """
    if not chain.findings:
        return chain
    after, kept = residuals(chain.fit, context.held_out), []
    least = CLEARLY / effective_samples(after)
    for k, found in enumerate(chain.findings):
        refuted = [rival for rival, fit in _close_rivals(chain, k, context)
                   if surer_improvement(residuals(fit, context.held_out), after,
                                        context.seed).low > least]
        kept.append(replace(found, rivals=tuple(
            rival for rival in found.rivals if rival not in refuted)))
    return replace(chain, findings=tuple(kept))


def _close_rivals(chain: Chain, k: int, context: Context
                  ) -> Iterator[tuple[tuple[Placed, float], Fit]]:
    """Fit each close rival in the place of an effect."""
    found, candidate = chain.findings[k], chain.fit.candidate
    close = [rival for rival in found.rivals if rival[1] < CLOSE]
    others = candidate.effects[:found.index], candidate.effects[found.index + 1:]
    fits = search_all([
        replace(candidate, effects=(*others[0], placed, *others[1]),
                timing={} if placed.effect.shifts else candidate.timing)
        for placed, _ in close], context.parts, LONG)
    return zip(close, fits, strict=True)
