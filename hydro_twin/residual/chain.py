"""The loop: effects added one after another, until nothing more earns its place."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from hydro_twin.effects import Effect, Placed
from hydro_twin.fitting.candidate import Candidate, Part
from hydro_twin.fitting.free_run import Fit
from hydro_twin.predictors.scores import rms
from hydro_twin.residual.noise import noise_floor
from hydro_twin.residual.proof import improvement, proof, residuals
from hydro_twin.residual.select import (
    CLEARLY,
    contend,
    Contender,
    criterion,
    gain_p_value,
    refine,
    search,
    search_all,
    stretches,
)
from hydro_twin.residual.structure import drift, drifts, foretold
from hydro_twin.result import NEAR

MOST = 3                # effects in a model
LEVEL = 1e-3            # of a test, corrected for all that was tried
WORTH = 0.01            # least share of the mean square error that the first effect takes off
MORE = 0.06             # and each after it, unless it settles what is left
FINE = 0.2              # largest error of the time stepping, as a share of the residual
FINE_ENOUGH, FINEST = 8, 16     # steps in a sample, while a model grows and in the end
ROUNDS = 8              # of adding an effect
LATER, AGAIN = 8, 4     # effects fitted in full after the first round, and for an exchange
ENOUGH = 0.5            # least share above the noise that each takes off, if something is left, or
#                         if others would take off as much
AS_MUCH = 0.8           # of what a law with memory explains, from which one without is enough
TOLD = 0.05             # p-value from which what is left follows what happens at the ports
SURELY = 1e-4           # and from which it surely does
NOISY = 2.0             # error over the noise's, from which more than noise is left
HELD_OUT = 1.2          # error on data not fitted, over that on data fitted, that is not chance
TRIED = 40              # starts tried in a round, for the correction


@dataclass(frozen=True)
class Finding:
    """One effect that earned its place.

    Attributes:
        index: of the effect in the candidate.
        p_value: of what it adds to the others, for all that was tried.
        share: of the mean square error without it that it takes off.
        rivals: (contender, distance of the criterion) of other effects in its place, best first.
    """

    index: int
    p_value: float
    share: float
    rivals: tuple[tuple[Contender, float], ...]


@dataclass(frozen=True)
class Chain:
    """A model as far as it has grown."""

    fit: Fit
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Ground:
    """What chains grow on, and what is known of it.

    Attributes:
        parts: what is fitted.
        held_out: what is not.
        contended: the contenders that had their turn on top of a fit.
        fits: the best fit with each set of effects.
    """

    parts: Sequence[Part]
    held_out: Sequence[Part]
    seed: int
    progress: Callable[[str], None]
    contended: dict[tuple[frozenset[str], int, int], list[Contender]] = field(
        default_factory=dict)
    fits: dict[frozenset[str], Fit] = field(default_factory=dict)

    def contend(self, fit: Fit, most: int) -> list[Contender]:
        """Fit effects on top of a fit, unless one with the same unknowns had its turn."""
        key = (_effects_of(fit.candidate), len(fit.unknowns), most)
        if key not in self.contended:
            self.contended[key] = contend(fit, self.parts, most, False, self.progress)
            for contender in self.contended[key]:
                self.remember(contender.fit)
        return self.contended[key]

    def remember(self, fit: Fit) -> None:
        """Keep a fit, unless a better one with the same effects is known."""
        key = _effects_of(fit.candidate)
        if key not in self.fits or fit.cost < self.fits[key].cost:
            self.fits[key] = fit

    def best(self, fit: Fit) -> Fit:
        """Return the best fit known with the effects of this one."""
        return min(fit, self.fits.get(_effects_of(fit.candidate), fit), key=lambda f: f.cost)

    def without(self, chain: Chain, findings: Sequence[Finding]) -> list[Fit]:
        """Take each effect out by itself, and fit the rest again.

        From where it stands and from where the best fit with the same effects stood: what an
        effect had drawn the others to is no good place to do without it.
        """
        starts = []
        for found in findings:
            bare = chain.fit.candidate.without(found.index)
            starts.append([bare])
            if known := self.fits.get(_effects_of(bare)):
                placed = {_name(p): p for p in known.candidate.effects}
                starts[-1].append(replace(
                    known.candidate, substeps=bare.substeps,
                    effects=tuple(placed[_name(p)] for p in bare.effects)))
        fits = search_all([start for some in starts for start in some], self.parts, 40)
        best = [min(islice(fits, len(some)), key=lambda fit: fit.cost) for some in starts]
        for fit in best:
            self.remember(fit)
        return best


def _effects_of(candidate: Candidate) -> frozenset[str]:
    """Name the effects of a candidate with their ports, in whatever order."""
    return frozenset(map(_name, candidate.effects))


def _name(placed: Placed) -> str:
    """Name an effect with its port."""
    return f'{placed.effect.id} {placed.port.kind} {placed.port.name}'


def grow(base: Fit, contenders: Sequence[Contender], ground: Ground) -> Chain:
    """Add the best effect, then the best of each further round, while they are likely.

    Which of them help on data that was not fitted is asked of the whole: beside a second effect
    that is still lacking, the first may not help there.

    Args:
        base: the fit without any of the effects.
        contenders: of the first round, best first.
        ground: the data.
    """
    chain = Chain(base)
    for _ in range(ROUNDS):
        if not contenders:
            break
        first, *others = _without_needless_memory(contenders, chain.fit, ground)
        fit = without_last(chain.fit, first.fit, ground.parts)
        chain = replace(chain, fit=fit)
        if not likely(fit, first.fit, WORTH):
            break
        found = _finding(fit, first.fit, others, len(fit.candidate.effects))
        if chain.findings and not _earned(found, fit, first, ground.parts):
            break
        better = finely(first.fit, ground.parts, FINE_ENOUGH)
        ground.remember(fit)
        ground.remember(better)
        chain = _exchange(Chain(better, (*chain.findings, found)), ground)
        chain = _refined(chain, ground)
        if len(chain.findings) == MOST:
            break
        contenders = ground.contend(chain.fit, LATER)
    return _proven(chain, base, ground)


def _without_needless_memory(contenders: Sequence[Contender], base: Fit, ground: Ground
                             ) -> list[Contender]:
    """Put a law without memory first, where it explains about as much as one with memory.

    Between steps of the command, hysteresis and a dead zone differ only in how they are left.
    What the former gains must show on held-out data, or a dead zone it is.

    Args:
        contenders: best first.
        base: the fit without any of them.
        ground: the data.
    """
    first = contenders[0]
    effect = first.placed.effect
    if effect.memory == 0 or effect.implicit or effect.dynamic:
        return list(contenders)
    for rival in contenders[1:]:
        enough = base.error**2 - rival.fit.error**2 > AS_MUCH * (
            base.error**2 - first.fit.error**2)
        if rival.placed.effect.memory == 0 and enough:
            helps = proof(rival.fit, first.fit, ground.held_out, ground.seed)
            if not helps.low > 0.0:
                return [rival, *(one for one in contenders if one is not rival)]
    return list(contenders)


def _earned(found: Finding, without: Fit, added: Contender, parts: Sequence[Part]) -> bool:
    """Whether a later effect is more than what an earlier law does not quite fit.

    What one law leaves is no evidence for just any other, so it must be clearly the best, unless
    it takes off half of it; and take off much, or alone all of what followed the signals at the
    ports.
    """
    nearest = _nearest(found, added.placed.effect)
    if nearest < CLEARLY and found.share < ENOUGH:
        return False
    return found.share > MORE or (
        nearest > NEAR and foretold(without, parts)[1] < SURELY
        and foretold(added.fit, parts)[1] > TOLD)


def _refined(chain: Chain, ground: Ground) -> Chain:
    """Let in the refinements of earlier effects that the one lacking hid; not those it feigned."""
    for found in chain.findings[:-1]:
        chain = replace(chain, fit=refine([chain.fit], ground.parts, found.index)[0])
        ground.remember(chain.fit)
    return chain


def without_last(base: Fit, better: Fit, parts: Sequence[Part]) -> Fit:
    """Search the base once more from where an effect has led; the better of the two.

    What a longer search alone gains must not be credited to the effect.
    """
    candidate = replace(better.candidate, effects=better.candidate.effects[:-1])
    return min(base, search(candidate, parts, 40), key=lambda fit: fit.cost)


def likely(before: Fit, after: Fit, worth: float) -> bool:
    """Whether an effect is likely and takes off the share that it must, of what was fitted."""
    return gain_p_value(before, after, TRIED) < LEVEL and share(before, after) > worth


def share(before: Fit, after: Fit) -> float:
    """Share of the mean square error that a later fit takes off."""
    return 1.0 - (after.error / max(before.error, 1e-300)) ** 2


def _proven(chain: Chain, alone: Fit, ground: Ground) -> Chain:
    """Drop the effects that do not help on data that was not fitted, the least helpful first.

    An effect helps if the whole interval of the improvement is above zero.

    Args:
        chain: a model that has grown.
        alone: the fit without any of its effects.
        ground: the data.
    """
    if not chain.findings:
        return chain
    bare = ground.without(chain, chain.findings)
    if len(bare) == 1:
        bare = [min(bare[0], alone, key=lambda fit: fit.cost)]
    after = residuals(chain.fit, ground.held_out)
    fails = {}
    for k, fit in enumerate(bare):
        before = residuals(fit, ground.held_out)
        helps = improvement(before, after, ground.seed).low
        if not helps > 0.0:
            fails[k] = helps
    if not fails:
        return chain
    least = min(fails, key=lambda k: fails[k])
    return _proven(Chain(bare[least], other_findings(chain, least)), alone, ground)


def supported(chain: Chain, alone: Fit, ground: Ground) -> Chain:
    """Drop effects that explain less of what is left without them than they leave, if any is.

    What explains a part only is not what is missing.

    Args:
        chain: a model that has grown.
        alone: the fit without any of its effects.
        ground: the data.
    """
    if not chain.findings or not _leaves_something(chain, ground):
        return chain
    bare = ground.without(chain, chain.findings) if len(chain.findings) > 1 else [alone]
    shares = [explained_share(fit, chain.fit) for fit in bare]
    least = int(np.argmin(shares))
    if shares[least] >= ENOUGH:
        return chain
    return supported(Chain(bare[least], other_findings(chain, least)), alone, ground)


def _leaves_something(chain: Chain, ground: Ground) -> bool:
    """Whether what is left cannot be noise.

    It follows what happens at the ports, or time, or is larger where nothing was fitted. With
    several effects, or a rival near, it is enough that more is left than white noise: coloured
    noise is, too, but they may be its doing.
    """
    fit = chain.fit
    held_out = rms(np.concatenate(residuals(fit, ground.held_out)))
    doubtful = len(chain.findings) > 1 or any(
        _nearest(f, fit.candidate.effects[f.index].effect) < NEAR for f in chain.findings)
    return (foretold(fit, ground.parts)[1] < TOLD or drifts(drift(fit))
            or not held_out <= HELD_OUT * fit.error
            or (doubtful and fit.error > NOISY * noise_floor(stretches(fit))))


def explained_share(before: Fit, after: Fit) -> float:
    """Share of the mean square error above the noise that a later fit takes off."""
    floor = noise_floor(stretches(after))
    return (before.error**2 - after.error**2) / max(before.error**2 - floor**2, 1e-300)


def other_findings(chain: Chain, k: int) -> tuple[Finding, ...]:
    """List the findings but one, as they are without its effect."""
    gone = chain.findings[k].index
    return tuple(replace(found, index=found.index - (found.index > gone))
                 for found in (*chain.findings[:k], *chain.findings[k + 1:]))


def _finding(without: Fit, fit: Fit, others: Sequence[Contender], index: int) -> Finding:
    """Describe an effect against the fit without it, and against others in its place."""
    score, *scores = criterion([fit, *(c.fit for c in others)])
    return Finding(
        index=index, p_value=gain_p_value(without, fit, TRIED),
        share=share(without, fit),
        rivals=tuple((c, s - score) for c, s in zip(others, scores, strict=True)))


def _nearest(found: Finding, effect: Effect) -> float:
    """Distance of the criterion to the nearest effect of another name.

    Delay, lag and mode hardly differ at low frequencies: beside one of them the others do not
    count. Linear dynamics are missing, whichever it is. Nor does a rival that was passed over for
    its memory, and so is at a negative distance: it says the same of the recording.
    """
    return min((d for contender, d in found.rivals if contender.id != effect.id and d >= 0.0
                and not (effect.dynamic and contender.placed.effect.dynamic)), default=np.inf)


def finely(fit: Fit, parts: Sequence[Part], finest: int) -> Fit:
    """Shorten the steps until halving them changes the output little, then fit again."""
    candidate = fit.candidate
    while candidate.substeps < finest:
        finer = replace(candidate, substeps=2 * candidate.substeps)
        starts = [(part.inputs, start.x, start.z) for part in parts
                  for start in [candidate.start(part)]]
        change = rms(np.concatenate([finer.system.run(*start) - candidate.system.run(*start)
                                     for start in starts]))
        if change < FINE * fit.error:
            break
        candidate = finer
    return fit if candidate is fit.candidate else search(candidate, parts, 40)


def _exchange(chain: Chain, ground: Ground) -> Chain:
    """Put each earlier effect up for choice again, now that the last one is in the model.

    It may have become needless, and is dropped; or it may have stood in for two, and another
    takes its place. Its rivals are those that it has beside the others.
    """
    for k, found in enumerate(chain.findings[:-1]):
        placed = chain.fit.candidate.effects[found.index]
        (without,), rest = ground.without(chain, [found]), other_findings(chain, k)
        with_it, bare = criterion([chain.fit, without])
        if bare < with_it + CLEARLY or share(without, chain.fit) < WORTH:
            return _exchange(Chain(without, rest), ground)
        contenders = ground.contend(without, AGAIN)
        scores = criterion([chain.fit, *(c.fit for c in contenders)])
        if contenders and scores[1] < scores[0] - CLEARLY:
            first, *others = contenders
            instead = _finding(without, first.fit, others, len(without.candidate.effects))
            better = finely(first.fit, ground.parts, FINE_ENOUGH)
            return _exchange(Chain(better, (*rest, instead)), ground)
        others = [c for c in contenders
                  if (c.id, c.placed.port) != (placed.effect.id, placed.port)]
        kept = _finding(without, chain.fit, others, found.index)
        chain = replace(chain, findings=(*chain.findings[:k], kept, *chain.findings[k + 1:]))
    return chain
