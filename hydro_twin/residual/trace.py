"""The loop: fit, residual, effect, refit, until nothing more earns its place."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.blas import one_thread
from hydro_twin.fitting.free_run import Fit, fit_linear
from hydro_twin.fitting.horizon import errors_over_horizon
from hydro_twin.fitting.outputs import sensors_in
from hydro_twin.fitting.parts import least_samples, Part, parts_of
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.model import Model, Record
from hydro_twin.plants import Plant
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import errors_by_series, rms
from hydro_twin.recording.series import moves_alike, Recording, split, split_by_series
from hydro_twin.residual.chain import (
    Chain,
    Context,
    ENOUGH,
    finely,
    FINEST,
    grow,
    other_findings,
    supported,
    without_last,
)
from hydro_twin.residual.curve import (
    explains_most,
    find_curve,
    FittedCurve,
    is_better,
    is_drawn,
)
from hydro_twin.residual.evaluate import result_of
from hydro_twin.residual.evidence import Evidence
from hydro_twin.residual.excerpt import excerpt, harmless_factor, resampled, thin
from hydro_twin.residual.limits import without_unreached
from hydro_twin.residual.noise import bursts, lines, noise_floor
from hydro_twin.residual.proof import improvement, proof, residuals
from hydro_twin.residual.screen import hidden
from hydro_twin.residual.select import (
    by_part,
    CLEARLY,
    criterion,
    fit_alternatives,
    search,
    search_all,
    unrefined,
)
from hydro_twin.residual.structure import (
    dependences,
    drift,
    free_curves,
    predicted_by_ports,
    shows,
)
from hydro_twin.result import (
    BestNamed,
    Dependence,
    Improvement,
    SERIES,
    SIXTH,
    THIRD,
    TraceResult,
)

AT_LAST = 60_000        # samples of a thinned recording that are all used in the final fit
EVERY = 1000            # effects fitted in full in the first round
LIKELY = 0.05           # p-value below which the named effects may not explain everything


@one_thread()
def trace(recording: Recording, test: Recording | None, plant: Plant,
          constants: Mapping[str, float] | None = None, model: Model | None = None,
          seed: int = 0, progress: Callable[[str], None] = lambda _: None) -> TraceResult:
    """Find what a plant's linear model lacks of a recording.

    Args:
        recording: what is fitted.
        test: what is not, and judges. None: the first third of every series of the recording.
            Where the model fails there, more happens than in the rest, as in a sweep that begins
            slowly; then the second sixth, and the first is fitted, if as much is found then.
            Where a plant that integrates moves otherwise there than in the rest, every third
            series instead, whole, if these do not.
        plant: the plant.
        constants: of the rig, where they differ from the plant's defaults.
        model: where to start, instead of a fresh fit of the linear plant.
        seed: of the random starts and of the bootstrap.
        progress: called with what is being done.

    Raises:
        DataError: a recording is too short, constant or not finite.
    """
    found = evidence(recording, test, plant, constants, model, seed, progress)
    progress('result')
    return result_of(found)


def evidence(recording: Recording, test: Recording | None, plant: Plant,
             constants: Mapping[str, float] | None = None, model: Model | None = None,
             seed: int = 0, progress: Callable[[str], None] = lambda _: None) -> Evidence:
    """Search for it, see `trace`, and return the fits and tests that a result is made of."""
    if test is not None:
        return _search(recording, test, plant, constants, model, seed, progress)
    if _one_way(split(recording), plant) and not _one_way(split_by_series(recording), plant):
        found = _search(*split_by_series(recording), plant, constants, model, seed, progress)
        return replace(found, tested=SERIES)
    found = _search(*split(recording), plant, constants, model, seed, progress)
    found = replace(found, tested=THIRD)
    too_short = all(len(series) < SIXTH * least_samples(plant, series.sample_time)
                    for series in recording.series)
    if too_short or not found.is_larger_held_out:
        return found
    again = _search(*split(recording, SIXTH, 1), plant, constants, model, seed, progress,
                    found.after.candidate)
    return replace(again, tested=SIXTH) if again.additions >= found.additions else found


def _one_way(parts: tuple[Recording, Recording], plant: Plant) -> bool:
    """Whether a plant that integrates moves otherwise where it is tested than where it is fitted.

    As a cylinder that extends in the first third of a series and retracts in the rest: neither
    part can say of the other whether its laws are right.
    """
    return plant.integrates and (
        not parts[1].series
        or not moves_alike(*parts, plant.output.name, plant.start_up))


def _search(train: Recording, test: Recording, plant: Plant,
            constants: Mapping[str, float] | None, model: Model | None, seed: int,
            progress: Callable[[str], None], known: Model | None = None) -> Evidence:
    """Search with one test part; `known` is the model that a search with another one found."""
    whole, held_out = parts_of(train, plant), parts_of(test, plant)
    sample_time = train.series[0].sample_time
    plant = plant.seen_by(sensors_in(whole, plant, plant.start_samples(sample_time)))
    fine = excerpt(whole, plant, sample_time)
    recorded = sum(len(part.measured) for part in whole)
    progress('linear model')
    plain = None
    if model is None:
        plain = fit_linear(plant, whole if recorded <= AT_LAST else fine,
                           plant.constant_values(constants), sample_time, 'box', timing=False,
                           seed=seed).candidate
        before = _linear(plain, fine, seed)
    else:
        before = search(resampled(replace(
            model, plant=plant, noise=None, record=Record()), sample_time), fine, 1)
    factor = harmless_factor(before, fine, recorded)
    while not all(excerpt(parts, plant, sample_time, factor) for parts in (whole, held_out)):
        factor //= 2        # what is thinned must be long enough, at factor 1 all of it is
    fine, fine_held_out = (excerpt(parts, plant, sample_time, factor)
                           for parts in (whole, held_out))
    parts, others = thin(fine, plant, factor), thin(fine_held_out, plant, factor)
    if factor > 1 and recorded <= AT_LAST:
        fine, fine_held_out = whole, held_out
    base = before
    if factor > 1 or model is not None:
        base = search(resampled(before.candidate, factor * sample_time), parts, 40)
    given = len(base.candidate.effects)
    single = [] if known is None else [
        replace(resampled(known, base.candidate.sample_time),
                effects=(*known.effects[:given], placed)) for placed in known.effects[given:]]
    context = Context(parts, others, _times([*whole, *held_out], sample_time), seed, progress)
    alternatives = fit_alternatives(base, parts, context.times, EVERY, True, progress, single)
    if alternatives:
        base = without_last(base, alternatives[0].fit, parts)
    chain = grow(base, alternatives, context)
    if chain.findings:
        better = search(finely(chain.fit, parts, FINEST).candidate, parts, 60)
        chain = supported(replace(chain, fit=better), base, context)
    if not chain.findings:
        chain = Chain(base)
    progress('free curve')
    chain, found, replaced = _with_curve(chain, base, context)
    final = chain.fit if found is None else found.fit
    if final is not base:
        bare = replace(final.candidate, effects=final.candidate.effects[:given])
        from_final = search(bare, parts, 40)
        base, first = min(context.best(base), from_final, key=lambda fit: fit.cost), base
        chain = Chain(base) if chain.fit is first else chain
    after = chain.fit
    if factor > 1:
        progress('all samples')
        named = after is not base
        base = _as_recorded(base, sample_time, fine)
        if plain:
            base = min(base, search(plain, fine, 20), key=lambda fit: fit.cost)
        after = _as_recorded(after, sample_time, fine) if named else base
        found = found and _on_all(found, after, sample_time, fine, held_out, seed)
    if model is None:
        before = base
    elif factor > 1:
        before = search(before.candidate, fine, 1)
    after = without_unreached(after, fine)
    found = found and replace(found, fit=without_unreached(found.fit, fine))
    # What is named must improve the reported figure, too.
    gain = _gain(before, after if found is None else found.fit, test, seed)
    if found and not gain.low > 0.0:
        found, gain = None, _gain(before, after, test, seed)
    if chain.findings and not gain.low > 0.0:
        chain, after = Chain(base), base
        gain = _gain(before, base, test, seed)
    pieces = by_part(after)
    traced = Evidence(
        plant=plant, before=before, after=after, train=whole, test=held_out,
        recordings={'train': train, 'test': test}, fitted=fine, hidden=(),
        findings=chain.findings,
        improvement=gain, held_out_error=rms(np.concatenate(residuals(after, fine_held_out))),
        floor=noise_floor(pieces), white=is_white(pieces),
        lines=tuple(lines(pieces, sample_time)),
        bursts=tuple(bursts(residuals(after, [*whole, *held_out]))),
        depends_on=tuple(dependences(after, fine)), drifts=drift(after, fine),
        by_ports=predicted_by_ports(after, fine), found=found,
        best_named=_best_named(replaced, others) if found and replaced else None)
    return traced if traced.fails else replace(traced, hidden=tuple(hidden(after, fine)))


def _times(parts: Sequence[Part], sample_time: float) -> tuple[float, float]:
    """Return the stamps [s] of the first and the last sample of all parts."""
    return (1e-9 * min(part.start for part in parts),
            max(1e-9 * part.start + sample_time * (len(part.measured) - 1) for part in parts))


def _linear(plain: Model, parts: Sequence[Part], seed: int) -> Fit:
    """Fit the linear plant within its physical range; no worse than the fit within the box.

    The gain of a better linear fit must not be credited to an effect.

    Args:
        plain: that fit, as `refit` makes it.
        parts: what is fitted.
        seed: of the random starts.
    """
    free = fit_linear(plain.plant, parts, plain.values, plain.sample_time, 'physical',
                      timing=True, seed=seed)
    return min(free, search(plain, parts, 40), key=lambda fit: fit.cost)


def _gain(before: Fit, after: Fit, test: Recording, seed: int) -> Improvement:
    """Compare the free runs on held-out data; over a horizon where the plant integrates."""
    candidates = before.candidate, after.candidate
    if before.candidate.plant.integrates:
        first, then = (errors_over_horizon(candidate, test) for candidate in candidates)
    else:
        first, then = (errors_by_series(Analytical(candidate), test.series, 'free_run')
                       for candidate in candidates)
    return improvement(first, then, seed)


def _best_named(chain: Chain, held_out: Sequence[Part]) -> BestNamed:
    """Describe the named effects that a free curve took the place of."""
    return BestNamed(tuple(chain.fit.candidate.effects[found.index] for found in chain.findings),
                     rms(np.concatenate(residuals(chain.fit, held_out))))


def _with_curve(chain: Chain, base: Fit, context: Context
                ) -> tuple[Chain, FittedCurve | None, Chain | None]:
    """Look for a free curve beside the named effects, or instead of them.

    Several named effects often imitate one law that has no name.

    Args:
        chain: the model with the named effects.
        base: the fit without any of them.
        context: the data.

    Returns:
        The chain, or one without its effects; the curve on top of it, if one helps; and the
        chain whose place it took, if it did.
    """
    parts, held_out, seed = context.parts, context.held_out, context.seed
    curves = free_curves(chain.fit, parts)
    at_first = curves if chain.fit is base else free_curves(base, parts)
    if chain.findings and _contested(chain, parts, curves, at_first):
        instead = find_curve(base, parts, held_out, at_first, seed)
        if instead and is_better(instead, base, chain.fit, at_first, held_out, seed):
            return Chain(base), instead, chain
    found = find_curve(chain.fit, parts, held_out, curves, seed)
    return (*_still_needed(chain, found, context), None) if found else (chain, None, None)


def _contested(chain: Chain, parts: Sequence[Part], curves: Sequence[Dependence],
               at_first: Sequence[Dependence]) -> bool:
    """Whether a curve may explain the residual without the named effects.

    The named effects may leave structure; or it took one effect at two ports; or one curve, at
    another port or signal, explains most of the first residual.
    """
    ids = [chain.fit.candidate.effects[found.index].effect.id for found in chain.findings]
    if (any(shows(curve) for curve in curves) or len(set(ids)) < len(ids)
            or not is_white(by_part(chain.fit))
            or predicted_by_ports(chain.fit, parts)[1] < LIKELY):
        return True
    return any(curve.share > ENOUGH and not is_drawn((curve.port, curve.signal), chain.fit,
                                                     at_first) for curve in at_first[:1])


def _still_needed(chain: Chain, found: FittedCurve, context: Context) -> tuple[Chain, FittedCurve]:
    """Withdraw named effects that the curve contains, as a bias that is its constant part.

    The least helpful first. But not one that explains by itself most of what the curve would in
    its place, which then only describes it more finely.
    """
    bare = context.without(chain, chain.findings)
    for k in sorted(range(len(bare)), key=lambda k: bare[k].error):
        without = bare[k]
        instead = search(found.fit.candidate.without(chain.findings[k].index), context.parts, 25)
        with_it, without_it = criterion([found.fit, instead])
        if (without_it < with_it + CLEARLY
                and not explains_most(without, chain.fit, instead)):
            helps = proof(without, instead, context.held_out, context.seed)
            return _still_needed(Chain(without, other_findings(chain, k)),
                                 replace(found, fit=instead, proof=helps), context)
    return chain, found


def _on_all(found: FittedCurve, after: Fit, sample_time: float, parts: Sequence[Part],
            held_out: Sequence[Part], seed: int) -> FittedCurve | None:
    """Fit a curve to all samples; None if it does not help on the held-out ones."""
    fit = _as_recorded(found.fit, sample_time, parts)
    helps = proof(after, fit, held_out, seed)
    return replace(found, fit=fit, proof=helps) if helps.low > 0.0 else None


def _as_recorded(fit: Fit, sample_time: float, parts: Sequence[Part]) -> Fit:
    """Fit a model that was found on thinned samples to all samples.

    Refinements of its effects, which may have made up for the thinning, must help again.
    """
    candidate = resampled(fit.candidate, sample_time)
    simple = replace(candidate, effects=tuple(map(unrefined, candidate.effects)))
    if simple.effects == candidate.effects:
        fine = search(candidate, parts, 20)
    else:
        refined, fine = search_all([candidate, simple], parts, 20)
        scores = criterion([refined, fine])
        fine = refined if scores[0] < scores[1] - CLEARLY else fine
    return finely(fine, parts, FINEST) if fine.candidate.effects else fine
