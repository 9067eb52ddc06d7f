"""The error over a horizon: free runs in windows, for plants whose long free runs drift.

Where a plant integrates, a free run of a whole series adds up every small error of the laws; where
it forgets slowly, the error of its initial state lasts. A window is as long as shows what the laws
do, and has an initial state of its own, estimated from its samples, see `eliminate`.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
import math

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.fitting.output_error import fitted_residuals
from hydro_twin.fitting.parts import least_samples, moved_between, Part, parts_of
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors import kind_named
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import errors_by_series, rms
from hydro_twin.recording.series import Recording

AT_END = 0.05           # share of the travel at either end that counts as the end
MIN_SAMPLES = 10        # samples between them that say how it moves
STANDS = 0.5            # least share at the ends from which a recording mostly stands there
HORIZON = 10.0          # [s], longest window: some strokes of a cylinder, few of a slow one
SHORTER = 8             # times: a constant force that is lacking moves a mass by a 64th as much
OF_START = 1.2          # free run over horizon, errors beyond which the difference is no chance


def windows(parts: Sequence[Part], longest: int, least: int, sample_time: float) -> list[Part]:
    """Cut each part into equal windows of at most `longest` samples, but of `least` at least."""
    cut = []
    for part in parts:
        n = len(part.measured)
        edges = np.linspace(0, n, min(math.ceil(n / longest), n // least) + 1).astype(int)
        cut += [part.cut(a, b, sample_time) for a, b in pairwise(edges.tolist())]
    return cut


def horizon_windows(parts: Sequence[Part], plant: Plant, sample_time: float) -> list[Part]:
    """Cut parts into windows of at most `HORIZON`, unless one that short could not be scored.

    Args:
        parts: each of `least_samples` or more.
        plant: the plant.
        sample_time: of the parts [s].
    """
    least = least_samples(plant, sample_time)
    longest = max(round(min(HORIZON, plant.horizon) / sample_time), least)
    return windows(parts, longest, least, sample_time)


def short_windows(model: Model, parts: Sequence[Part]) -> list[Part]:
    """Cut the windows of a plant that integrates into shorter ones; none where that cannot be."""
    if not model.plant.integrates:
        return []
    least = least_samples(model.plant, model.sample_time)
    short = [window for part in parts for window in windows(
        [part], len(part.measured) // SHORTER, least, model.sample_time)]
    return short if len(short) > len(parts) else []


def between_ends(parts: Sequence[Part], sample_time: float) -> list[Part]:
    """Cut out what lies between the ends of the travel of the output."""
    low, high = moved_between(parts)
    margin = AT_END * (high - low)
    found = []
    for part in parts:
        inside = (part.measured > low + margin) & (part.measured < high - margin)
        edges = np.flatnonzero(np.diff(inside, prepend=False, append=False)).tolist()
        found += [part.cut(a, b, sample_time)
                  for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= MIN_SAMPLES]
    return found


def moving_windows(parts: Sequence[Part], plant: Plant, sample_time: float
                   ) -> tuple[list[Part], float]:
    """Cut the windows that linear laws are fitted to, without standing at a stop.

    Laws that know no stop would be led to a gain of zero by a recording that mostly stands at one.

    Args:
        parts: each of `least_samples` or more.
        plant: the plant.
        sample_time: of the parts [s].

    Returns:
        Windows, and the share of the samples that are left out because the output is at an end of
        its travel: 0 unless that is most of them.
    """
    least = least_samples(plant, sample_time)
    moving = [part for part in between_ends(parts, sample_time) if len(part.measured) >= least]
    kept = (sum(len(part.measured) for part in moving)
            / sum(len(part.measured) for part in parts))
    if not 0.0 < kept < STANDS:
        moving, kept = list(parts), 1.0
    return horizon_windows(moving, plant, sample_time), 1.0 - kept


def errors_over_horizon(model: Model, recording: Recording) -> list[FloatArray]:
    """Return measured minus predicted over each window, scored samples only.

    Raises:
        DataError: no series is long enough.
    """
    parts = parts_of(recording, model.plant)
    return fitted_residuals(model, horizon_windows(parts, model.plant, model.sample_time))


def judged_errors(model: Model, recording: Recording) -> tuple[list[FloatArray], bool]:
    """Return the errors that test the laws best, and whether they are over a horizon.

    Where the plant integrates, or forgets slowly, the error of a free run is dominated by the
    error of its initial state, which is estimated from few samples.

    Raises:
        DataError: no series is long enough.
    """
    over_horizon = errors_over_horizon(model, recording)
    if model.plant.integrates:
        return over_horizon, True
    free = errors_by_series(Analytical(model), recording.series, 'free_run')
    if rms(np.concatenate(free)) <= OF_START * rms(np.concatenate(over_horizon)):
        return free, False
    return over_horizon, True


def horizon_errors(model: Model, parts: Mapping[str, Recording]) -> dict[str, dict[str, float]]:
    """Score a model over a horizon on named parts, as 'train' and 'test'.

    Returns:
        {'horizon': part -> RMS error}; nothing of a model that is not analytical, nor where a part
        has no series that is long enough, or stands still.
    """
    if not kind_named(model.kind).analytical:
        return {}
    try:
        return {'horizon': {name: rms(np.concatenate(errors_over_horizon(model, part)))
                            for name, part in parts.items()}}
    except DataError:
        return {}
