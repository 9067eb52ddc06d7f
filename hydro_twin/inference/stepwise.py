"""Forward selection of effects, with an exchange of earlier ones after each."""
from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.effects import Effect
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import fitted_residuals, initial_states, runs
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import P_PREDICTED, predicted_by_ports
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.inference.context import Context, EffectKeys, effects_of
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic, gain_p_value
from hydro_twin.inference.findings import (
    best_finding,
    explained_share,
    Finding,
    finding,
    in_place,
    other_findings,
    Selection,
    share,
    TRIED,
)
from hydro_twin.inference.held_out import held_out_gain, residuals
from hydro_twin.inference.refinement import is_distinguishable, refine
from hydro_twin.inference.search import (
    LONG,
    search,
    search_all,
    search_sticking,
    sticks,
    unsearched,
)
from hydro_twin.inference.select import Alternative, best_first, fit_alternatives
from hydro_twin.inference.starts import relocated
from hydro_twin.inference.structure import drift_test, is_drift_significant
from hydro_twin.model import Model
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.system import HOLD, LINEAR
from hydro_twin.result import NEAR_DELTA_BIC

MOST_EFFECTS = 3        # in a model: a fourth was right in some simulated cylinders, and false in
#                         others
SIGNIFICANCE = 1e-3     # level of the test of an effect, corrected for all that was tried
MIN_SHARE = 0.01        # of the mean square error that the first effect removes
MIN_SHARE_LATER = 0.06  # and each after it, unless it explains all that is left
FINE = 0.2              # largest error of the time stepping, as a share of the residual
DISCRETISATION = 0.5    # the same from which it may be all of the residual: with further halving
#                         it adds up to twice as much
FINE_ENOUGH, FINEST = 8, 16     # steps in a sample, while a model grows and in the end
ROUNDS = 8              # most rounds: an exchange may drop effects, so that three of them can take
#                         more than three rounds
LATER, AGAIN = 8, 4     # effects fitted in full after the first round, and for an exchange
MIN_EXPLAINED_SHARE = 0.5  # least share above the noise that each takes off, if something is left,
#                         or if others would take off as much
MEMORYLESS_SHARE = 0.8  # share of a hysteretic law's gain from which a static one is enough
P_SURELY_PREDICTED = 1e-4    # p-value below which the port signals certainly predict it
MAX_HELD_OUT_RATIO = 1.2    # ratio of held-out to training error above which it is not chance
RIVALS = 1.5            # error over that of the effect in place: what leaves more after ten
#                         evaluations is no rival to it, nor a way to a better model


def select_forward(selection: Selection, alternatives: Sequence[Alternative], context: Context,
                   refuted: Container[str] = ()) -> Selection:
    """Add the best effect, then the best of each further round, while they are significant.

    Held-out data judge the whole model: beside a second effect that is still missing, the first
    may not improve them.

    Args:
        selection: what has been found before.
        alternatives: of the first round, best first.
        context: the data.
        refuted: ids of effects that are not to be added.
    """
    seen: set[EffectKeys] = set()
    for _ in range(ROUNDS):
        alternatives = [one for one in alternatives if one.id not in refuted]
        if not alternatives or effects_of(selection.fit.candidate) in seen:
            break
        ranked = _memoryless_first(alternatives, selection.fit, context)
        first = ranked[0]
        fit = without_last(selection.fit, first.fit, context.parts)
        context.remember(fit)
        selection = replace(selection, fit=fit)
        if not is_significant(fit, first.fit, MIN_SHARE):
            break
        found = best_finding(fit, ranked)
        if selection.findings and not _earned(found, fit, first, context.parts):
            break
        better = with_fine_steps(first.fit, context.parts, FINE_ENOUGH)
        better = best_timing(better, context.parts)
        better = _refined_sticking(better, context.parts)
        context.remember(better)
        selection = exchange(Selection(better, (*selection.findings, found)), context)
        selection = refined(selection, selection.findings[:-1], context)
        selection = without_indistinct(selection, context)
        seen.add(effects_of(fit.candidate))
        if (len(selection.findings) == MOST_EFFECTS
                or is_discretisation_error(selection.fit, context.parts)):
            break
        alternatives = context.fit_alternatives(selection.fit, LATER)
    return selection


def _refined_sticking(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Search a model that sticks by homotopy, and the forms of its last effect likewise.

    Forms that were judged by a plain search may all have stalled, and with long time steps
    the breakaway does not show.
    """
    fit = search_sticking(fit, parts)
    last = fit.candidate.effects[-1].effect
    if sticks(fit.candidate) and last.implicit and not is_white(fit.by_part):
        (fit,) = refine([fit], parts, by_homotopy=True)
    return fit


def _memoryless_first(alternatives: Sequence[Alternative], base: Fit, context: Context
                      ) -> list[Alternative]:
    """Put a static law first where it explains about as much as one with memory.

    Between steps of the command, hysteresis and a dead zone differ only at reversals. The gain of
    hysteresis must show on held-out data; else the dead zone is taken, if need be at another of
    its ports: where its search began it may have ended in a local minimum.

    Args:
        alternatives: best first.
        base: the fit without any of them.
        context: the data.
    """
    first = alternatives[0]
    if not first.placed.branches or first.placed.effect.dynamic:
        return list(alternatives)
    for rival in alternatives[1:]:
        enough = base.error**2 - rival.fit.error**2 > MEMORYLESS_SHARE * (
            base.error**2 - first.fit.error**2)
        static = not (rival.placed.remembers or rival.placed.effect.dynamic)
        if static and enough:
            others = (one for one in alternatives if one is not rival)
            for static_law in _at_ports(rival.fit, context):
                helps = held_out_gain(static_law, first.fit, context.held_out, context.seed)
                if not helps.low > 0.0:
                    return [Alternative(static_law), *others]
    return list(alternatives)


def _at_ports(fit: Fit, context: Context) -> Iterator[Fit]:
    """Yield a fit, then the best with its last effect at another port, if there is one."""
    yield fit
    moved = search_all(relocated(fit.candidate, context.parts), context.parts, LONG)
    yield from best_first([*moved])[:1]


def _earned(found: Finding, without: Fit, added: Alternative, parts: Sequence[Part]) -> bool:
    """Whether a later effect is more than the misfit of an earlier law.

    The residual of one law is no evidence for any other. So the effect must be clearly the best,
    unless it removes half of the residual; and remove much of it, or, as the only one, all that
    is there: what is left is white, or the port signals predict it no longer. Of whitened parts
    any residual is white.
    """
    nearest = _nearest(found, added.placed.effect)
    if nearest < CLEAR_DELTA_BIC and found.share < MIN_EXPLAINED_SHARE:
        return False
    if found.share > MIN_SHARE_LATER:
        return True
    before, after = delta_bic([without, added.fit])
    white = is_white(added.fit.by_part) and not parts[0].filters
    return (min(nearest, before - after) > NEAR_DELTA_BIC
            and predicted_by_ports(added.fit, parts)[1] > P_PREDICTED
            and (white or predicted_by_ports(without, parts)[1] < P_SURELY_PREDICTED))


def refined(selection: Selection, findings: Sequence[Finding], context: Context) -> Selection:
    """Refine effects again, now that what came after them no longer biases them."""
    for found in findings:
        selection = replace(selection, fit=refine([selection.fit], context.parts, found.index)[0])
        context.remember(selection.fit)
    return selection


def without_indistinct(selection: Selection, context: Context) -> Selection:
    """Put another effect in the place of each that is no longer distinguished from a simpler one.

    Beside a later effect a dead zone may shrink to nothing about a centre, and so be a bias.
    """
    for _ in selection.findings:
        k = next(indistinct(selection.fit, context.parts, selection.findings), None)
        if k is None:
            break
        found, rest = selection.findings[k], other_findings(selection, k)
        (without,) = context.without(selection.fit, [found.index])
        # With all else as it is beside the effect: refitted without it, it may lead astray.
        bare = unsearched(selection.fit.candidate.without(found.index), context.parts)
        alternatives = fit_alternatives(bare, context.parts, context.times, AGAIN, afresh=False,
                                        progress=context.progress)
        if alternatives and is_significant(without, alternatives[0].fit, MIN_SHARE):
            found = best_finding(without, alternatives)
            selection = Selection(alternatives[0].fit, (*rest, found))
        else:
            selection = Selection(without, rest)
        context.remember(selection.fit)
    return selection


def indistinct(fit: Fit, parts: Sequence[Part], findings: Sequence[Finding]) -> Iterator[int]:
    """Yield which of the effects found the recording does not distinguish from simpler ones."""
    return (k for k, found in enumerate(findings)
            if not is_distinguishable(fit, parts, found.index))


def without_last(base: Fit, better: Fit, parts: Sequence[Part]) -> Fit:
    """Fit the base once more from the parameters of a fit with an effect; the better of the two.

    The gain of a longer search must not be credited to the effect.
    """
    return min(base, search(better.candidate.without(-1), parts, LONG), key=lambda fit: fit.cost)


def is_significant(before: Fit, after: Fit, worth: float) -> bool:
    """Whether an effect is significant and removes the least share of the training error.

    And lowers what the fits minimise: an error that is smaller only because the parameters have
    left their usual values further is not the effect's doing. A delay can be fitted so, since
    it takes the place of the timing.
    """
    return (after.cost < before.cost and gain_p_value(before, after, TRIED) < SIGNIFICANCE
            and share(before, after) > worth)


def without_unsupported(selection: Selection, without: Fit, context: Context) -> Selection:
    """Drop effects that explain too little of the residual without them, if structure remains.

    An effect that explains only a part is not the one that is missing. Half is enough.

    Args:
        selection: a model that has grown.
        without: the fit without any of its effects.
        context: the data.
    """
    if not selection.findings or not is_residual_structured(selection, context):
        return selection
    bare = (context.without(selection.fit, selection.indices) if len(selection.findings) > 1
            else [without])
    explained = [explained_share(fit, selection.fit) for fit in bare]
    worst = int(np.argmin(explained))
    if explained[worst] >= MIN_EXPLAINED_SHARE:
        return selection
    rest = Selection(bare[worst], other_findings(selection, worst))
    return without_unsupported(rest, without, context)


def is_residual_structured(selection: Selection, context: Context) -> bool:
    """Whether the residual cannot be noise.

    The port signals or time predict it, or it is larger on held-out data. That it is larger than
    white noise does not show it: the noise may be coloured.
    """
    fit = selection.fit
    held_out = rms(np.concatenate(residuals(fit, context.held_out)))
    return (predicted_by_ports(fit, context.parts)[1] < P_PREDICTED
            or is_drift_significant(drift_test(fit, context.parts))
            or not held_out <= MAX_HELD_OUT_RATIO * fit.error)


def _nearest(found: Finding, effect: Effect) -> float:
    """Delta BIC of the closest effect of another name.

    Delay, lag and mode hardly differ at low frequencies: beside one of them the others do not
    count, since all say that linear dynamics are missing. Nor does a hysteretic rival that was
    passed over for a static law, with a negative delta BIC: it says the same of the recording.
    """
    return min((d for rival, d in found.rivals if rival.effect.id != effect.id and d >= 0.0
                and not (effect.dynamic and rival.effect.dynamic)), default=np.inf)


def with_fine_steps(fit: Fit, parts: Sequence[Part], finest: int) -> Fit:
    """Shorten the steps until halving them changes the output little, then fit again."""
    candidate = fit.candidate
    while (candidate.substeps < finest
           and step_halving_change(candidate, parts) >= FINE * fit.error):
        candidate = replace(candidate, substeps=2 * candidate.substeps)
    return fit if candidate is fit.candidate else search(candidate, parts, LONG)


def step_halving_change(candidate: Model, parts: Sequence[Part]) -> float:
    """Say by how much half as long steps change the output, RMS, whitened.

    From the same initial states; where a load swings, from those fitted to either, since its law
    takes the velocity as constant in the first step.
    """
    finer, initial = replace(candidate, substeps=2 * candidate.substeps), initial_states(
        candidate, parts)
    swings = any(placed.swings for placed in candidate.effects)
    now, then = (fitted_residuals(model, parts, initial) if swings else
                 [part.whitened(y) for part, y in zip(
                     parts, runs(model, parts, initial.x, initial.z), strict=True)]
                 for model in (candidate, finer))
    return rms(np.concatenate(then) - np.concatenate(now))


def is_discretisation_error(fit: Fit, parts: Sequence[Part]) -> bool:
    """Whether what is left is no more than the error of the time steps.

    As of a simulation without noise; no law is to be found in it.
    """
    return step_halving_change(fit.candidate, parts) > DISCRETISATION * fit.error


def best_timing(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Fit once more with another timing of the commands, and take it where it explains more.

    With commands that act at their stamps, where a fit without the effect has left the timing at
    an edge of its range: a search may not lead back from there.

    And with commands interpolated, or held, where that clearly explains more. A controller holds
    its command until the next. That of an operator, or of a controller faster than the recording,
    moves on; held, it meets a limit or a dead zone in steps that it never had.
    """
    candidate = fit.candidate
    at_stamps = replace(candidate, timing=dict.fromkeys(candidate.timing, 0.0))
    if any(name.startswith('timing:') for name in fit.at_bound()):
        fit = min(fit, search(at_stamps, parts, LONG), key=lambda one: one.cost)
    other = LINEAR if candidate.interpolation == HOLD else HOLD
    otherwise = search(replace(at_stamps, interpolation=other), parts, LONG)
    now, then = delta_bic([fit, otherwise])
    return otherwise if then < now - CLEAR_DELTA_BIC and share(fit, otherwise) > MIN_SHARE else fit


def exchange(selection: Selection, context: Context, last: bool = False,
             left: frozenset[EffectKeys] = frozenset()) -> Selection:
    """Choose each earlier effect again, now that the last one is in the model.

    An effect that has become unnecessary is dropped; one that stood in for two is replaced. Its
    rivals are those beside the other effects. A set of effects that was replaced is not returned
    to, since each of two sets may fit better when it is searched from the other. Nor is an effect
    dropped if another compensates for it only in a form that is not distinguished from a simpler
    effect, as a small part of a ripple is from an offset.

    Args:
        selection: a model that has grown.
        context: the data.
        last: whether to choose the last one again, too.
        left: sets of effects that were replaced before.
    """
    left |= {effects_of(selection.fit.candidate)}
    for k, found in enumerate(selection.findings[:None if last else -1]):
        placed = selection.fit.candidate.effects[found.index]
        (without,) = context.without(selection.fit, [found.index])
        rest = other_findings(selection, k)
        with_it, bare = delta_bic([selection.fit, without])
        needless = bare < with_it + CLEAR_DELTA_BIC or share(without, selection.fit) < MIN_SHARE
        if needless and next(indistinct(without, context.parts, rest), None) is None:
            return exchange(Selection(without, rest), context, last, left)
        alternatives = context.fit_alternatives(without, AGAIN, RIVALS * selection.fit.error)
        scores = delta_bic([selection.fit, *(c.fit for c in alternatives)])
        if (alternatives and scores[1] < scores[0] - CLEAR_DELTA_BIC
                and effects_of(alternatives[0].fit.candidate) not in left):
            instead = best_finding(without, alternatives)
            better = with_fine_steps(alternatives[0].fit, context.parts, FINE_ENOUGH)
            return exchange(Selection(better, (*rest, instead)), context, last, left)
        others = [c for c in alternatives if c.placed.key != placed.key]
        kept = finding(without, selection.fit, in_place(others), found.index)
        findings = (*selection.findings[:k], kept, *selection.findings[k + 1:])
        selection = replace(selection, findings=findings)
    return selection
