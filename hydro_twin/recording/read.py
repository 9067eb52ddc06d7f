"""Reads bags into a recording: what all of the offline verbs start with."""
from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from hydro_twin.errors import BagError
from hydro_twin.recording.bag import read_signals
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.grid import MIN_SAMPLES, to_grid
from hydro_twin.recording.series import Recording
from hydro_twin.recording.signals import SignalMap


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
    series = []
    for path in paths:   # each is let go before the next: samples take more room than the grid
        found = to_grid(read_signals(Path(path), signals, optional), held, sample_time, str(path))
        if not found:
            raise BagError(f'{path} holds no {MIN_SAMPLES} samples in a row, {sample_time:g} s '
                           f'apart, with all of {", ".join(signals)}')
        series += found
    return Recording(tuple(series), tuple(source_of(Path(path)) for path in paths))
