"""Reads bags into a recording: what all of the offline verbs start with."""
from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
import logging
from pathlib import Path

import numpy as np

from hydro_twin.errors import BagError
from hydro_twin.recording.bag import read_signals, Samples
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.grid import beside, MIN_SAMPLES, to_grid
from hydro_twin.recording.series import Recording, Series
from hydro_twin.recording.signals import SignalMap

log = logging.getLogger(__name__)


def read_recording(paths: Sequence[Path], signals: Mapping[str, SignalMap], held: Collection[str],
                   sample_time: float, optional: Collection[str] = ()) -> Recording:
    """Read bags, put their signals on a uniform grid, and split them at gaps.

    Args:
        paths: bags: folders, or single .mcap or .db3 files.
        signals: where each signal is found.
        held: the signals that keep their value until the next (commands).
        sample_time: of the grid [s].
        optional: signals that a bag may lack; its series then have no column for them.

    Raises:
        BagError: a bag cannot be read, or lacks a signal, or holds no stretch with all of them.
    """
    series: list[Series] = []
    for path in paths:   # each is freed before the next: samples take more memory than the grid
        series += on_grid(path, read_signals(Path(path), signals, optional), held, sample_time)
    return Recording(tuple(series), tuple(source_of(Path(path)) for path in paths))


def on_grid(path: Path, samples: Mapping[str, Samples], held: Collection[str], sample_time: float,
            sensors: Mapping[str, Samples] | None = None) -> list[Series]:
    """Put the samples of a bag on a uniform grid, and split them at gaps.

    Args:
        path: of the bag.
        samples: of the signals that must be there.
        held: the signals that keep their value until the next (commands).
        sample_time: of the grid [s].
        sensors: samples of what else was measured, which neither splits nor shortens a series; a
            series has a column of one that moves in it, nan where it is missing.

    Raises:
        BagError: no stretch with all signals is long enough.
    """
    found = to_grid(samples, held, sample_time, str(path))
    if not found:
        raise BagError(f'{path} holds no {MIN_SAMPLES} samples in a row, {sample_time:g} s apart, '
                       f'with all of {", ".join(samples)}')
    moving = {}
    for name, recorded in (sensors or {}).items():
        if np.ptp(recorded.values) > 0.0:
            moving[name] = recorded
        else:
            log.warning('%s: %s stands at %g all the time: it is left out', path, name,
                        recorded.values[0])
    return [with_sensors(series, moving) for series in found]


def with_sensors(series: Series, sensors: Mapping[str, Samples]) -> Series:
    """Add the columns of those sensors that have samples within a series."""
    columns = {name: beside(series, samples) for name, samples in sensors.items()}
    return replace(series, columns={**series.columns, **{
        name: column for name, column in columns.items() if np.isfinite(column).any()}})
