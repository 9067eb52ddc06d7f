"""What was found must also improve the error that is reported, on held-out data."""
from __future__ import annotations

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import errors_over_horizon, judged_errors
from hydro_twin.inference.curve import FittedCurve
from hydro_twin.inference.findings import Selection
from hydro_twin.inference.held_out import improvement, surer_improvement
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import errors_by_series, first_scored
from hydro_twin.recording.series import Recording
from hydro_twin.result import Improvement


def confirmed(before: Fit, base: Fit, selection: Selection, found: FittedCurve | None,
              test: Recording, seed: int
              ) -> tuple[Selection, FittedCurve | None, Improvement, bool]:
    """Keep what improves the reported figure, too, and surely beats a constant.

    Returns also how much it improves it, see `reported_gain`.
    """
    gain, by_horizon = reported_gain(before, (found or selection).fit, test, seed)
    if found and not gain.low > 0.0:
        found = None
        gain, by_horizon = reported_gain(before, selection.fit, test, seed)
    if selection.findings and not (gain.low > 0.0 and (
            by_horizon or beats_constant((found or selection).fit, test, seed))):
        selection, found = Selection(base), None
        gain, by_horizon = reported_gain(before, base, test, seed)
    return selection, found, gain, by_horizon


def beats_constant(fit: Fit, test: Recording, seed: int) -> bool:
    """Whether a free run is surely better on held-out data than the mean of each series.

    An offset improves a model that cannot follow at all, and explains nothing.
    """
    plant = fit.candidate.plant
    left = errors_by_series(Analytical(fit.candidate), test.series, 'free_run')
    scored = [one[plant.output.name][first_scored(one, plant, 'free_run'):] for one in test.series]
    return improvement([one - one.mean() if len(one) else one for one in scored],
                       left, seed).low > 0.0


def reported_gain(before: Fit, after: Fit, test: Recording, seed: int
                  ) -> tuple[Improvement, bool]:
    """Compare two models on held-out data.

    By the free run, or by the error over a horizon: where the start decides a free run, and where
    a free run improves, but by its start alone not for sure. An error over a horizon that falls,
    but hardly where one of few windows meets what was not there to be fitted, as an end stop, may
    fall for sure by its geometric mean.

    Returns:
        The improvement, and whether it is that of the error over a horizon.
    """
    then, by_horizon = judged_errors(after.candidate, test)
    if not by_horizon:
        first = errors_by_series(Analytical(before.candidate), test.series, 'free_run')
        gain = improvement(first, then, seed)
        if gain.low > 0.0 or not gain.relative > 0.0:
            return gain, False
        then = errors_over_horizon(after.candidate, test)
    first = errors_over_horizon(before.candidate, test)
    gain = improvement(first, then, seed)
    unsure = gain.low <= 0.0 < gain.relative
    return surer_improvement(first, then, seed) if unsure else gain, True
