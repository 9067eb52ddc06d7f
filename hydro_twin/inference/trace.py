"""The loop: fit, residual, effect, refit, until nothing more earns its place."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hydro_twin.blas import one_thread
from hydro_twin.errors import DataError
from hydro_twin.fitting.coloured import as_measured, whitened
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import errors_over_horizon
from hydro_twin.fitting.linear import fit_linear, refuse_reversed
from hydro_twin.fitting.output_error import free_run_error, size_of
from hydro_twin.fitting.outputs import sensors_in
from hydro_twin.fitting.parts import Part, parts_of, thin, with_travel
from hydro_twin.fitting.port_signals import predicted_by_ports
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.inference.confirmation import confirmed, reported_gain
from hydro_twin.inference.context import Context
from hydro_twin.inference.continuation import shorter_horizon
from hydro_twin.inference.curve import FittedCurve
from hydro_twin.inference.curve_or_names import best_named
from hydro_twin.inference.determined import without_undetermined
from hydro_twin.inference.evaluate import result_of
from hydro_twin.inference.evidence import Evidence
from hydro_twin.inference.excerpt import decimation_factor, excerpt, resampled
from hydro_twin.inference.explanation import explain, Explanation
from hydro_twin.inference.findings import Selection, share
from hydro_twin.inference.held_out import held_out_gain, residuals
from hydro_twin.inference.limits import without_unreached
from hydro_twin.inference.memory import combine_with_earlier, named
from hydro_twin.inference.noise import bursts, lines, noise_floor
from hydro_twin.inference.refinement import unrefined
from hydro_twin.inference.screen import undetectable
from hydro_twin.inference.search import LONG, search, search_all, unsearched
from hydro_twin.inference.splits import held_out_split, second_split
from hydro_twin.inference.stepwise import (
    best_timing,
    FINE_ENOUGH,
    FINEST,
    MAX_HELD_OUT_RATIO,
    MIN_SHARE,
    with_fine_steps,
)
from hydro_twin.inference.structure import dependences, drift_test
from hydro_twin.model import Model, Record
from hydro_twin.plants import Plant
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Recording, split
from hydro_twin.result import Memory, TraceResult

MAX_FINAL_SAMPLES = 60_000    # samples of a thinned recording that are all used in the final fit
FURTHER = 20            # evaluations of the fit to all samples, which starts at the fit to thinned
#                         ones
SAME = 1.02             # ratio of mean square errors on held-out data up to which none is worse


@one_thread()
def trace(recording: Recording, test: Recording | None, plant: Plant,
          constants: Mapping[str, float] | None = None, model: Model | None = None,
          seed: int = 0, progress: Callable[[str], None] = lambda _: None,
          earlier: Recording | None = None) -> TraceResult:
    """Find what a plant's linear model lacks of a recording.

    Args:
        recording: what is fitted.
        test: what is not, and judges. None: the first third of every series of the recording, or
            another part where the output moves otherwise there than in the rest, see
            `held_out_split`. Where the model fails there, more happens than in the rest, as in a
            sweep that begins slowly; then every third series, or the second sixth of each, see
            `second_split`, if what is found then holds, or is as much.
        plant: the plant.
        constants: of the rig, where they differ from the plant's defaults.
        model: where to start, instead of a fresh fit of the linear plant.
        seed: of the random starts and of the bootstrap.
        progress: called with what is being done.
        earlier: what the model to start from was made of, see `memory`.

    Raises:
        DataError: a recording is too short, constant or not finite, or the output moves against
            the command.
    """
    if earlier is not None and model is not None:
        for part in split(earlier):     # refused now rather than after the search
            parts_of(part, plant)
    found = evidence(recording, test, plant, constants, model, seed, progress)
    if earlier is not None and model is not None:
        progress('fitting the earlier recordings')
        found = _with_memory(found, model, earlier, seed)
    progress('evaluating')
    return result_of(found)


def evidence(recording: Recording, test: Recording | None, plant: Plant,
             constants: Mapping[str, float] | None = None, model: Model | None = None,
             seed: int = 0, progress: Callable[[str], None] = lambda _: None) -> Evidence:
    """Search for it, see `trace`, and return the fits and tests that a result is made of."""
    if test is not None:
        return _search(recording, test, plant, constants, model, seed, progress)
    parts, tested = held_out_split(recording, plant)
    found = replace(_search(*parts, plant, constants, model, seed, progress), tested=tested)
    if tested != 'third' or not found.is_larger_held_out:
        return found
    second = second_split(recording, plant)
    if second is None:
        return found
    parts, tested = second
    again = _search(*parts, found.plant, constants, model, seed, progress, found.after.candidate)
    # Effects that only make up for another one on the part that was fitted are many, and fail.
    holds = again.additions > 0 and not again.is_larger_held_out
    if not (holds or again.additions >= found.additions):
        return found
    # A model may also hold for leaving much everywhere.
    whole, then = (_whole_error(one, recording) for one in (found, again))
    return replace(again, tested=tested) if then <= MAX_HELD_OUT_RATIO * whole else found


def _whole_error(found: Evidence, recording: Recording) -> float:
    """Return the error over a horizon on all that was recorded, whichever part was fitted."""
    return size_of(errors_over_horizon(found.final.candidate, recording))


def _with_memory(found: Evidence, model: Model, earlier: Recording, seed: int) -> Evidence:
    """Combine with the recordings that a model came from, unless held-out data refute it.

    The findings and what is said of the residual stay those of the new recording alone.

    Args:
        found: in the new recording, from the model on.
        model: that was started from.
        earlier: what it came from; the first third of every series tests.
        seed: of the bootstrap.
    """
    sample_time = found.before.candidate.sample_time
    train, held_out = (excerpt(parts_of(part, found.plant), found.plant, sample_time)
                       for part in split(earlier))
    start, alone = resampled(model, sample_time), found.final
    together = combine_with_earlier(alone, found.fitted, start, train)
    new = excerpt(found.test, found.plant, sample_time)
    used = _mean_square(together.fit, new) <= SAME * _mean_square(alone, new)
    memory = Memory(
        tuple(source.path for source in earlier.sources), used,
        tuple(named(alone.candidate, unknown) for unknown in together.moved),
        *(free_run_error(one, held_out)
          for one in (start, (together.fit if used else alone).candidate)))
    if not used:
        return replace(found, memory=memory)
    final = ({'after': together.fit} if found.curve is None else
             {'curve': replace(found.curve, fit=together.fit)})
    gain, by_horizon = reported_gain(found.before, together.fit, found.recordings['test'], seed)
    return replace(found, **final, memory=memory, known=together.known, improvement=gain,
                   by_horizon=by_horizon)


def _mean_square(fit: Fit, parts: Sequence[Part]) -> float:
    return rms(np.concatenate(residuals(fit, parts))) ** 2


class _Data(NamedTuple):
    """The data of a search, each for training and held out.

    Attributes:
        train, held_out: all that was recorded.
        fine, fine_held_out: an excerpt of that, or all, as recorded.
        coarse, coarse_held_out: the same, thinned.
        factor: by which it is thinned.
        sample_time: as recorded [s].
    """

    train: Sequence[Part]
    held_out: Sequence[Part]
    fine: Sequence[Part]
    fine_held_out: Sequence[Part]
    coarse: Sequence[Part]
    coarse_held_out: Sequence[Part]
    factor: int
    sample_time: float


def _search(train: Recording, test: Recording, plant: Plant,
            constants: Mapping[str, float] | None, model: Model | None, seed: int,
            progress: Callable[[str], None], known: Model | None = None) -> Evidence:
    """Search with one test part; `known` is a model with effects that was found before."""
    whole, held_out = with_travel(parts_of(train, plant), _held_out_parts(test, plant))
    sample_time = train.series[0].sample_time
    plant = plant.seen_by(sensors_in(whole, plant, plant.start_samples(sample_time)))
    progress('fitting the linear model')
    fine = excerpt(whole, plant, sample_time)
    linear = None
    if model is None:
        few = _count(whole) <= MAX_FINAL_SAMPLES
        linear = fit_linear(plant, whole if few else fine, plant.constant_values(constants),
                            sample_time, seed).candidate
        before = search(linear, fine, LONG)
        refuse_reversed(before, fine)
    else:
        before = search(resampled(replace(
            model, plant=plant, noise=None, record=Record()), sample_time), fine, 1)
    shorter = None if known else shorter_horizon(
        before, fine, _times([*whole, *held_out], sample_time), progress)
    if shorter:
        plant = replace(plant, horizon=shorter[0])
        return _search(train, test, plant, constants, model, seed, progress,
                       replace(shorter[1], plant=plant))
    data = _thinned(before, fine, whole, held_out, sample_time)
    base = before
    if data.factor > 1 or model is not None:
        base = search(resampled(before.candidate, data.factor * sample_time), data.coarse, LONG)
    base = with_fine_steps(base, data.coarse, FINE_ENOUGH)
    base, explained = _explain(base, data, known, seed, progress)
    before, base, selection, found = _fitted_to_all(
        before, base, linear, explained, data, seed, progress)
    selection, found, gain, by_horizon = confirmed(before, base, selection, found, test, seed)
    after = selection.fit
    pieces = after.by_part
    left = residuals(after, whitened(data.fine_held_out, after) if after.whitened
                     else data.fine_held_out)
    traced = Evidence(
        plant=plant, before=before, after=after, train=whole, test=held_out,
        recordings={'train': train, 'test': test}, fitted=data.fine, undetectable=(),
        findings=selection.findings, improvement=gain, by_horizon=by_horizon,
        held_out_ratio=rms(np.concatenate(left)) / max(after.error, 1e-300),
        floor=noise_floor(pieces), white=is_white(pieces),
        lines=tuple(lines(pieces, sample_time)),
        bursts=tuple(bursts(residuals(after, [*whole, *held_out]))),
        depends_on=tuple(dependences(after, data.fine)), drifts=drift_test(after, data.fine),
        by_ports=predicted_by_ports(after, data.fine), curve=found,
        best_named=best_named(explained.replaced, data.coarse_held_out) if (
            found and explained.replaced) else None)
    return traced if traced.fails else replace(
        traced, undetectable=tuple(undetectable(after, data.fine)))


def _held_out_parts(test: Recording, plant: Plant) -> list[Part]:
    """Return the parts of what is held out; a refusal says that it is these."""
    try:
        return parts_of(test, plant)
    except DataError as error:
        raise DataError(f'the held-out part: {error}') from None


def _count(parts: Sequence[Part]) -> int:
    """Count the samples of parts."""
    return sum(len(part.measured) for part in parts)


def _thinned(before: Fit, fine: Sequence[Part], whole: Sequence[Part],
             held_out: Sequence[Part], sample_time: float) -> _Data:
    """Thin recordings as far as the free run of the linear model hardly changes by it."""
    plant = before.candidate.plant
    factor = decimation_factor(before, fine, _count(whole))
    while not all(excerpt(parts, plant, sample_time, factor) for parts in (whole, held_out)):
        factor //= 2        # what is thinned must be long enough, at factor 1 all of it is
    some, some_held_out = (excerpt(parts, plant, sample_time, factor)
                           for parts in (whole, held_out))
    every = factor > 1 and _count(whole) <= MAX_FINAL_SAMPLES
    return _Data(whole, held_out, whole if every else some, held_out if every else some_held_out,
                 thin(some, plant, factor), thin(some_held_out, plant, factor), factor,
                 sample_time)


def _explain(base: Fit, data: _Data, known: Model | None, seed: int,
             progress: Callable[[str], None]) -> tuple[Fit, Explanation]:
    """Search for what a model lacks; returns also the model without it, fitted no worse.

    Args:
        base: the model.
        data: what is fitted, and what tests.
        known: a model with effects that another search found.
        seed: of the bootstrap.
        progress: called with what is being done.
    """
    given = len(base.candidate.effects)
    single = [] if known is None else [
        replace(resampled(known, base.candidate.sample_time),
                effects=(*known.effects[:given], placed)) for placed in known.effects[given:]]
    times = _times([*data.train, *data.held_out], data.sample_time)
    context = Context(data.coarse, data.coarse_held_out, times, seed, progress)
    explained = explain(base, context, single)
    base = explained.base
    if explained.fit is base:
        return base, explained
    bare = replace(explained.fit.candidate, effects=explained.fit.candidate.effects[:given])
    from_final = search(bare, data.coarse, LONG)
    better = min(context.best(base), from_final, key=lambda fit: fit.cost)
    if explained.selection.fit is base:
        explained = explained._replace(selection=Selection(better))
    return better, explained


def _fitted_to_all(before: Fit, base: Fit, linear: Model | None, explained: Explanation,
                   data: _Data, seed: int, progress: Callable[[str], None]
                   ) -> tuple[Fit, Fit, Selection, FittedCurve | None]:
    """Fit the models to all samples, and drop what these do not determine.

    Args:
        before: the model to start from, fitted.
        base: the model without what was found.
        linear: the linear model from its several starts; None where another was given.
        explained: what was found.
        data: what is fitted.
        seed: of the bootstrap.
        progress: called with what is being done.

    Returns:
        The fit before, that without what was found, the named effects, and the curve.
    """
    selection, found, after = explained.selection, explained.curve, explained.selection.fit
    if data.factor > 1:
        progress('fitting all samples')
        named = after is not base
        base = _as_recorded(base, data.sample_time, data.fine)
        if linear:
            base = min(base, search(linear, data.fine, FURTHER), key=lambda fit: fit.cost)
        after = _as_recorded(after, data.sample_time, data.fine) if named else base
        found = found and _on_all(found, after, data, seed)
    if linear:
        before = base
    elif data.factor > 1:
        before = search(before.candidate, data.fine, 1)
    after = without_unreached(after, data.fine)
    if found:
        found = replace(found, fit=without_unreached(found.fit, data.fine))
        return before, base, replace(selection, fit=after), found
    kept = without_undetermined(replace(selection, fit=after), base, data.fine)
    last = base if selection.findings and not kept.findings else after
    before, base = (kept.fit if fit is last else fit for fit in (before, base))
    return before, base, kept, None


def _times(parts: Sequence[Part], sample_time: float) -> tuple[float, float]:
    """Return the stamps [s] of the first and the last sample of all parts."""
    return (1e-9 * min(part.start for part in parts),
            max(1e-9 * part.start + sample_time * (len(part.measured) - 1) for part in parts))


def _on_all(found: FittedCurve, after: Fit, data: _Data, seed: int) -> FittedCurve | None:
    """Fit a curve to all samples; None if it does not help on the held-out ones.

    Judged by the likelihood, where the noise is coloured; what is reported is of the run itself.
    """
    fit = _as_recorded(found.fit, data.sample_time, data.fine)
    helps = held_out_gain(after, fit, data.held_out, seed)
    judged = (held_out_gain(after, fit, whitened(data.held_out, after), seed) if after.whitened
              else helps)
    return replace(found, fit=fit, gain=helps) if judged.low > 0.0 else None


def _as_recorded(fit: Fit, sample_time: float, parts: Sequence[Part]) -> Fit:
    """Fit a model that was found on thinned samples to all samples.

    Refinements of its effects, which may have made up for the thinning, must help again. By how
    much they lower the error, and not by BIC: far above the noise, at full rate, whitening leaves
    of a residual little but the errors of the time steps.
    """
    candidate = resampled(fit.candidate, sample_time)
    if fit.whitened:
        white = whitened(parts, unsearched(candidate, parts))
        return as_measured(_as_recorded(replace(fit, whitened=None), sample_time, white), parts)
    simple = replace(candidate, effects=tuple(map(unrefined, candidate.effects)))
    if simple.effects == candidate.effects:
        fine = search(candidate, parts, FURTHER)
    else:
        refined, fine = search_all([candidate, simple], parts, FURTHER)
        fine = refined if share(fine, refined) > MIN_SHARE else fine
    if fine.candidate.effects:
        fine = best_timing(fine, parts)
    return with_fine_steps(fine, parts, FINEST)
