"""Refined forms of an effect's law, let in where they are clearly better than the simple one."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import short_windows
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.unknowns import label
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, refinement_gain
from hydro_twin.inference.effect_signals import effect_signals
from hydro_twin.inference.screen import spans
from hydro_twin.inference.search import (
    LONG,
    search_all,
    search_all_sticking,
    SHORT,
    TOLERANCE,
    unsearched,
)
from hydro_twin.inference.starts import with_other
from hydro_twin.model import Model


def refine(fits: Sequence[Fit], parts: Sequence[Part], index: int = -1,
           by_homotopy: bool = False) -> list[Fit]:
    """Add refinements to the law of an effect, the last or another, where clearly better.

    And remove those that are not: they made up for an effect that was missing at the time. Nor is
    a form taken that the recording does not distinguish from a simpler effect, as a limit so soft
    that it is none: the simple law may still stand. Each fit is refined by itself; they are fitted
    in one batch.

    Args:
        fits: the fits.
        parts: what was fitted.
        index: of the effect.
        by_homotopy: whether forms that stick are searched by homotopy, see `search_sticking`.
    """
    formed = [_forms(fit, parts, index) for fit in fits]
    formed = [[*forms, *begun] for forms, begun in zip(
        formed, _from_short_windows(formed, parts, index), strict=True)]
    short = search_all([form for forms in formed for form in forms], parts, SHORT)
    if by_homotopy:
        short = search_all_sticking(list(short), parts)
    simple, chosen = [], []
    for fit, forms in zip(fits, formed, strict=True):
        tried = [fit, *islice(short, len(forms))]
        simplest = tried[int(bool(forms) and _is_refined(fit, index))]
        gains = [refinement_gain(simplest, form) for form in tried]
        better = [tried[k] for k in np.argsort(gains)[::-1] if not gains[k] < CLEAR_DELTA_BIC]
        simple.append(simplest)
        chosen.append(next((form for form in better
                            if is_distinguishable(form, parts, index)), simplest))
    long = search_all([best.candidate for best, fit in zip(chosen, fits, strict=True)
                       if best is not fit], parts, LONG)
    refined = [fit if best is fit else next(long)
               for best, fit in zip(chosen, fits, strict=True)]
    # The same form from another start may end worse than the fit that there was.
    refined = [min(form, fit, key=lambda one: one.cost) if _same_form(form, fit) else form
               for form, fit in zip(refined, fits, strict=True)]
    refined = [form if form is fit else unrefined_if_same(form, parts, index)
               for form, fit in zip(refined, fits, strict=True)]
    return [form if form is fit or is_distinguishable(form, parts, index) else plain
            for form, fit, plain in zip(refined, fits, simple, strict=True)]


def _from_short_windows(formed: Sequence[Sequence[Model]], parts: Sequence[Part], index: int
                        ) -> list[list[Model]]:
    """Fit forms of a law that sticks to shorter windows, where the plant integrates.

    Whether and when a mass breaks away moves all that follows, so that the error of a long run
    has many minima.
    """
    sticking = [[form for form in forms if form.effects[index].effect.implicit]
                for forms in formed]
    every = [form for forms in sticking for form in forms]
    windows = short_windows(every[0], parts) if every else []
    fits = search_all(every if windows else [], windows, SHORT)
    return [[fit.candidate for fit in islice(fits, len(forms))] for forms in sticking]


def unrefined_if_same(fit: Fit, parts: Sequence[Part], index: int) -> Fit:
    """Return the simple law in place of a refinement that ended where it changes nothing.

    As a time constant of 1e200 s does, with which a drift goes in a straight line.
    """
    if not _is_refined(fit, index):
        return fit
    placed = fit.candidate.effects[index]
    plain = unsearched(with_other(fit.candidate, index, unrefined(placed)), parts)
    return plain if plain.cost**2 < (1.0 + TOLERANCE) * fit.cost**2 else fit


def _same_form(fit: Fit, other: Fit) -> bool:
    """Whether two fits have the same unknowns, with those of loads that swing."""
    return ([*map(label, fit.unknowns)] == [*map(label, other.unknowns)]
            and fit.swings == other.swings)


def _is_refined(fit: Fit, index: int) -> bool:
    """Whether a refinement of the effect is in."""
    placed = fit.candidate.effects[index]
    return any(p.refinement not in (None, v)
               for p, v in zip(placed.effect.parameters, placed.values, strict=True))


def unrefined(placed: Placed) -> Placed:
    """Return an effect in its simple form, without any refinement."""
    if placed.effect.plain is not None:
        return replace(placed, values=placed.effect.plain(placed.values))
    return replace(placed, values=tuple(
        v if p.refinement is None else p.refinement
        for p, v in zip(placed.effect.parameters, placed.values, strict=True)))


def _forms(fit: Fit, parts: Sequence[Part], index: int) -> list[Model]:
    """List other forms of an effect: the simple law, unless it is that, then refined ones."""
    placed = fit.candidate.effects[index]
    if placed.effect.refined is None:
        return []

    plain = unrefined(placed).values
    reach = spans(fit.candidate, parts)[placed.port]
    simplest = [plain] if _is_refined(fit, index) else []
    return [with_other(fit.candidate, index, replace(placed, values=tuple(values)))
            for values in (*simplest, *placed.effect.refined(reach, placed.values))]


def is_distinguishable(fit: Fit, parts: Sequence[Part], index: int = -1) -> bool:
    """Whether the recording distinguishes an effect, as fitted, from a simpler one."""
    placed = fit.candidate.effects[index]
    if placed.effect.distinguishable is None:
        return True

    def added_swing() -> float:
        runs = (effect_signals(fit.candidate, placed, part).added for part in parts)
        return max(float(np.ptp(run[fit.candidate.start_up:])) for run in runs)

    return placed.effect.distinguishable(
        replace(spans(fit.candidate, parts)[placed.port], added_swing=added_swing), placed.values)
