"""Which part of a recording is held out: one that moves as the rest does."""
from __future__ import annotations

from hydro_twin.fitting.horizon import HORIZON
from hydro_twin.fitting.parts import least_samples
from hydro_twin.plants import Plant
from hydro_twin.recording.series import (
    moves_alike,
    Recording,
    split,
    split_by_series,
    split_by_windows,
)
from hydro_twin.result import TestPart

Split = tuple[Recording, Recording]         # train, test


def held_out_split(recording: Recording, plant: Plant) -> tuple[Split, TestPart]:
    """Hold out the first third of every series, unless it moves otherwise than the rest.

    As of a cylinder that extends there and retracts in the rest, or an axis that stands: neither
    part can say of the other whether its laws are right. Then every third series is held out, or,
    where the plant integrates, so that windows are fitted anyway, every third window, if these do
    move as the rest.

    Returns:
        The split, and which it is, see `TraceResult.tested`.
    """
    first = split(recording)
    if _moves_alike(first, plant):
        return first, 'third'
    if _moves_alike(by_series := split_by_series(recording), plant):
        return by_series, 'series'
    for shorter in (1, 2, 4) if plant.integrates else ():
        if _moves_alike(by_windows := split_by_windows(recording, HORIZON / shorter), plant):
            return by_windows, 'windows'
    return first, 'third'


def second_split(recording: Recording, plant: Plant) -> tuple[Split, TestPart] | None:
    """Hold out another part where more happens in the first third than in the rest.

    Every third series, if there are three and these move as the others, so that what happens in
    the first third is in both parts; otherwise the second sixth of every series.

    Returns:
        As `held_out_split`; None where these parts are too short.
    """
    by_series, by_sixths = split_by_series(recording), split(recording, 6, 1)
    if len(recording.series) > 2 and _moves_alike(by_series, plant):
        return by_series, 'series'
    too_short = all(len(series) < least_samples(plant, series.sample_time)
                    for series in by_sixths[1].series)
    return None if too_short else (by_sixths, 'sixth')


def _moves_alike(parts: Split, plant: Plant) -> bool:
    return bool(parts[1].series) and moves_alike(*parts, plant.output.name, plant.start_up)
