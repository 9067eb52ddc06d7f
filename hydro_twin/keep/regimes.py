"""The operating regimes of a rig, and which of them recordings have shown.

A regime is where the output is and how much the measured signals move, over a window: one of three
levels of the output, and one of three movements of it and of each input that is measured.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import json
from pathlib import Path

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import ModelError
from hydro_twin.plants.plant import Plant, Signal
from hydro_twin.recording.series import Recording, Series
from hydro_twin.store.change import quantity
from hydro_twin.store.version import REGIMES

WINDOW = 1.0      # [s]: holds some periods of a servo at work, and is short against a regime
FEWEST = 16       # samples of a window: a standard deviation of fewer is known to 20 % at best
OUTLYING = 0.02   # share of samples or windows beyond the range that the edges divide
LITTLE, MUCH = 0.1, 1 / 3      # of the largest movement: half a decade apart, so that what an
#                                effect of small motion changes is not averaged with large motion
SEEN = 20.0       # time in a regime from which on it counts as seen before [s]: less is a passage

Edges = tuple[float, float]


@dataclass(frozen=True)
class Grid:
    """Where one regime ends and the next begins.

    Attributes:
        level: edges of the mean output, in its unit.
        movement: name -> edges of the standard deviation within a window, in the unit of the
            signal; first of the output, then of each input that is measured.
    """

    level: Edges
    movement: Mapping[str, Edges]


@dataclass(frozen=True)
class Known:
    """What the recordings of a rig say of its regimes, for one challenger.

    Attributes:
        seen: name -> how long the recordings were in a regime [s], at least `SEEN`.
        holds: name -> evidence that the challenger holds there, from recordings that it was not
            made from, in `mode`.
    """

    mode: str
    grid: Grid
    seen: Mapping[str, float]
    holds: Mapping[str, float]


def measured(plant: Plant) -> tuple[Signal, ...]:
    """List the signals that define a regime: the output, and inputs that are no commands."""
    return (plant.output, *(signal for signal in plant.inputs if not signal.held))


def window_of(sample_time: float) -> int:
    """Count the samples of a window, from the sample time [s]."""
    return max(round(WINDOW / sample_time), FEWEST)


def windows(series: Series, plant: Plant) -> FloatArray:
    """Cut the measured signals of a series into windows, (windows, signals, samples)."""
    size = window_of(series.sample_time)
    count = len(series) // size
    return np.stack([series[signal.name][:count * size].reshape(count, size)
                     for signal in measured(plant)], axis=1)


def grid_of(recording: Recording, plant: Plant) -> Grid:
    """Divide what recordings show: the range of the output in three, movements by their size.

    Raises:
        ModelError: no series is as long as a window.
    """
    cut = np.concatenate([windows(series, plant) for series in recording.series])
    if not len(cut):
        raise ModelError(f'no stretch of the recordings is as long as a window, {WINDOW:g} s')
    low, high = np.quantile(cut[:, 0], [OUTLYING, 1.0 - OUTLYING])
    largest = np.quantile(cut.std(axis=2), 1.0 - OUTLYING, axis=0)
    third = (high - low) / 3.0
    return Grid((float(low + third), float(high - third)),
                {signal.name: (float(LITTLE * most), float(MUCH * most))
                 for signal, most in zip(measured(plant), largest, strict=True)})


def regime(grid: Grid, plant: Plant, window: FloatArray) -> str:
    """Name the regime of a window (signals, samples)."""
    parts = []
    for k, (signal, movement) in enumerate(zip(measured(plant), window.std(axis=1), strict=True)):
        where = '' if k else f' {_span(float(window[0].mean()), grid.level, signal.unit)},'
        parts.append(f'{signal.name}{where} moving '
                     f'{_span(float(movement), grid.movement[signal.name], signal.unit)}')
    return '; '.join(parts)


def _span(value: float, edges: Edges, unit: str) -> str:
    low, high = (quantity(edge, unit) for edge in edges)
    if value > edges[1]:
        return f'above {high}'
    return f'{low} to {high}' if value > edges[0] else f'below {low}'


def seen(recording: Recording, plant: Plant, grid: Grid) -> dict[str, float]:
    """Say how long recordings were in each regime that counts as seen [s]."""
    found: dict[str, float] = {}
    for series in recording.series:
        for window in windows(series, plant):
            name = regime(grid, plant, window)
            found[name] = found.get(name, 0.0) + window.shape[1] * series.sample_time
    return {name: seconds for name, seconds in found.items() if seconds >= SEEN}


def read_known(folder: Path) -> Known | None:
    """Read what is known of the regimes for a version; None where its folder says nothing.

    Raises:
        ModelError: the file is damaged.
    """
    path = folder / REGIMES
    if not path.is_file():
        return None
    try:
        record = json.loads(path.read_text('utf-8'))
        grid = record['grid']
        movement = {name: _edges(edges) for name, edges in grid['movement'].items()}
        return Known(str(record['mode']), Grid(_edges(grid['level']), movement),
                     *({str(name): float(value) for name, value in record[key].items()}
                       for key in ('seen', 'holds')))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ModelError(f'{path}: damaged ({type(error).__name__}: {error})') from error


def _edges(given: Sequence[float]) -> Edges:
    low, high = map(float, given)
    return low, high
