"""A picture of what was measured against what models predict, with their errors."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.files import written_whole
from hydro_twin.plants.plant import Plant
from hydro_twin.recording.series import Recording
from hydro_twin.report.chart import AFTER, BEFORE, FOUND

SHOWN = 1000                                              # samples, of the first series
COLOURS = (BEFORE, AFTER, FOUND, '#e7298a')     # distinct to the colour-blind, too


def draw(recording: Recording, plant: Plant, runs: Mapping[str, Sequence[FloatArray]],
         errors: Mapping[str, float]) -> Figure:
    """Draw how a recording begins: above the output, below the errors.

    Args:
        recording: what was measured.
        plant: what was recorded.
        runs: name of a model -> its free run over every series, in the output's unit.
        errors: name of a model -> RMS of its free-run error over the whole recording.

    Returns:
        The figure; its legend has the errors.
    """
    output = plant.output
    measured = recording.series[0][output.name][:SHOWN]
    time = recording.series[0].sample_time * np.arange(len(measured))
    figure = Figure(figsize=(9, 5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    above.plot(time, measured, color='black', linewidth=2.5, label='measured')
    for k, (name, run) in enumerate(runs.items()):
        predicted, colour = run[0][:SHOWN], COLOURS[k % len(COLOURS)]
        above.plot(time, predicted, color=colour, linewidth=1.2, label=f'{name}, free run')
        below.plot(time, measured - predicted, color=colour, linewidth=1,
                   label=f'{name}: {errors[name]:.3g} {output.unit} RMS')
    above.set_ylabel(f'{output.meaning} [{output.unit}]')
    below.set(xlabel='time [s]', ylabel=f'measured - predicted [{output.unit}]')
    for axes in (above, below):
        axes.margins(x=0)
        axes.grid(alpha=0.3)
        axes.legend(loc='lower left', bbox_to_anchor=(0, 1), ncols=1 + len(runs), frameon=False)
    return figure


def write_picture(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, atomically; the same figure gives the same bytes."""
    with written_whole(path) as part:
        figure.savefig(part, format='png', dpi=90, metadata={'Software': None})
