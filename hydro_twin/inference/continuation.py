"""From short windows to long ones: where a search over long free runs begins.

The error of a long free run has many minima: one that is off by half a period of a ripple meets it
in the wrong phase, and no step of a search leads from there. Over a short window a run stays near
what was measured, and the minimum is wide. So the effects are first fitted to short windows, each
with its own initial state, and go on from there [Ribeiro et al. 2020, Automatica 121].
"""
from __future__ import annotations

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import windows
from hydro_twin.fitting.parts import least_samples
from hydro_twin.inference.chain import LATER
from hydro_twin.inference.context import Context
from hydro_twin.inference.select import fit_alternatives, LONG, search
from hydro_twin.model import Model

SHORTER = 8             # times: a constant force that is lacking moves a mass by a 64th as much


def from_short_windows(base: Fit, context: Context) -> list[Model]:
    """Fit effects to short windows of a plant that integrates, where a long run is soon far off.

    Args:
        base: the model without effects, fitted to the data.
        context: the data.

    Returns:
        The best models with one effect more; none where the plant forgets, or the windows of the
        data are no longer than it takes.
    """
    candidate, parts = base.candidate, context.parts
    if not candidate.plant.integrates:
        return []
    least = least_samples(candidate.plant, candidate.sample_time)
    short = [window for part in parts for window in windows(
        part, max(len(part.measured) // SHORTER, least), least, candidate.sample_time)]
    if len(short) == len(parts):
        return []
    context.progress('fitting short windows')
    found = fit_alternatives(search(candidate, short, LONG), short, context.times, LATER, True,
                             context.progress)
    return [one.fit.candidate for one in found[:LATER]]
