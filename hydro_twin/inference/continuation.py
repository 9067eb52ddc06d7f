"""Short windows of a plant that integrates: where a search over long ones begins, and its check.

The error of a long free run has many minima: one that is off by half a period of a ripple meets it
in the wrong phase, and no step of a search leads from there. And a linear fit to long runs may end
far off, as without inertia, where the constant torque of dry friction is what it lacks. Over a
short window a run stays near what was measured, and the minimum is wide. So effects are first
fitted to short windows, each with its own initial state, and go on from there [Ribeiro et al.
2020, Automatica 121].

A long run also adds up what no law explains, and a law may be chosen for making up for that, as a
dead zone of the torque where a joint has dry friction. Over short windows little of it adds up.

And where a force pushes on what it has moved, as gravity does on a pendulum near the top, no run
follows for long, under the right laws either. Then the horizon is as long as one can.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from hydro_twin.effects import Placed
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import short_windows, windows
from hydro_twin.fitting.parts import least_samples, movement, Part
from hydro_twin.inference.context import Context
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.findings import Selection
from hydro_twin.inference.screen import places
from hydro_twin.inference.search import LONG, search, search_all
from hydro_twin.inference.select import fit_alternatives, KEPT
from hydro_twin.inference.starts import with_other
from hydro_twin.inference.stepwise import LATER
from hydro_twin.model import Model

FOLLOWS = 0.25          # error over the movement within the windows, below which a run follows it


def from_short_windows(base: Fit, context: Context) -> list[Model]:
    """Fit effects to short windows of a plant that integrates and may have periodic ones.

    Args:
        base: the model without effects, fitted to the data.
        context: the data.

    Returns:
        The best models with one more, and all with a periodic one; none where the plant forgets,
        or has no place for one.
    """
    candidate = base.candidate
    short = short_windows(candidate, context.parts)
    if not short or not any(effect.periodic for effect, _ in places(
            candidate.plant, candidate.effects)):
        return []
    context.progress('fitting short windows')
    found = fit_alternatives(search(candidate, short, LONG), short, context.times, LATER,
                             afresh=True, progress=context.progress)
    return [one.fit.candidate for rank, one in enumerate(found)
            if rank < KEPT or one.placed.effect.periodic]


def shorter_horizon(base: Fit, parts: Sequence[Part], times: tuple[float, float],
                    progress: Callable[[str], None]) -> tuple[float, Model] | None:
    """Find how long a model follows, with an effect more, where that is shorter than the windows.

    Args:
        base: the model, fitted to the parts.
        parts: windows of a plant that integrates.
        times: stamps [s] of the first and the last sample.
        progress: called with what is being done.

    Returns:
        The time [s], and that model; None where the model itself follows, or one with an effect
        more does over all of the windows, or none does over shorter ones.
    """
    candidate = base.candidate
    if (not candidate.plant.integrates or _follows(base, parts)
            or not any(effect.periodic for effect, _ in places(candidate.plant, ()))):
        return None
    progress('looking for a horizon')
    least = least_samples(candidate.plant, candidate.sample_time)

    def cut(longest: int) -> list[Part]:
        return windows(parts, longest, least, candidate.sample_time)

    longest = max(len(part.measured) for part in parts)
    length, short, fit = longest, parts, base
    while not _follows(fit, short) and length >= 2 * least:
        length //= 2
        short = cut(length)
        fit = search(candidate, short, LONG)
    found = fit_alternatives(fit, short, times, LATER, afresh=True, progress=progress)
    best = min([fit, *(one.fit for one in found[:1])], key=lambda one: one.error)
    if not _follows(best, short):
        return None
    while length < longest:
        twice = cut(2 * length)
        longer = search(best.candidate, twice, LONG)
        if not _follows(longer, twice):
            return length * candidate.sample_time, best.candidate
        length, best = 2 * length, longer
    return None


def _follows(fit: Fit, parts: Sequence[Part]) -> bool:
    """Whether the error of runs is small against the movement within the windows."""
    return fit.error < FOLLOWS * movement([part.measured for part in parts])


def with_rivals_of_short_windows(selection: Selection, context: Context) -> Selection:
    """Set the delta BIC of rivals that are clearly better on short windows to zero.

    An effect that fits long runs better, but short ones worse, is not the right law, or not the
    only one. Rivals with a state of their own are excluded: its free initial value favours them.
    """
    candidate = selection.fit.candidate
    short = short_windows(candidate, context.parts) if selection.findings else []
    if not short:
        return selection
    context.progress('comparing on short windows')
    named, findings = {placed.effect.id for placed in candidate.effects}, []
    for found in selection.findings:
        rivals: dict[str, Placed] = {}
        for placed, _ in found.rivals:
            effect = placed.effect
            is_free = effect.dynamic or placed.branches
            if effect.id not in named and not is_free:
                rivals.setdefault(effect.id, placed)
        score, *scores = delta_bic(list(search_all(
            [candidate, *(with_other(candidate, found.index, placed)
                          for placed in rivals.values())], short, LONG)))
        better = [placed for placed, other in zip(rivals.values(), scores, strict=True)
                  if other < score - CLEAR_DELTA_BIC]
        findings.append(replace(found, rivals=tuple(sorted(
            ((placed, 0.0 if placed in better else distance)
             for placed, distance in found.rivals), key=lambda rival: rival[1]))))
    return replace(selection, findings=tuple(findings))
