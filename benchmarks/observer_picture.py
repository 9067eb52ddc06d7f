"""Draws the observer beside the one-step prediction, a picture of docs/live.md (`make picture`).

    python -m benchmarks.observer_picture bags/rig_a out/model.yaml docs/img/observer.png

A second of a recording: what was measured, what the model predicts in one step and as an observer,
and the band that is to hold 95 % of the measurements. Prints how many it holds.
"""
from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from hydro_twin import api
from hydro_twin.model import read_model
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.report.picture import COLOURS, write_picture

BEGIN, LENGTH = 1.0, 1.0    # of what is drawn, in the first series [s]
NORMAL = 1.96               # standard deviations on either side that hold 95 %


def main() -> None:
    """Draw a bag."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    for name in ('bag', 'model', 'picture'):
        parser.add_argument(name, type=Path)
    args = parser.parse_args()
    model = read_model(args.model)
    output, predictor = model.plant.output, Analytical(model)
    every = api.read([args.bag], model.plant).recording.series
    runs = [predictor.filter.run(predictor.inputs(one), one[output.name], start=one.start)[0]
            for one in every]
    held = [np.mean(np.abs(one[output.name] - run[:, 0])[model.start_up:]
                    < NORMAL * np.sqrt(run[model.start_up:, 1]))
            for one, run in zip(every, runs, strict=True)]
    series, observed, band = every[0], runs[0][:, 0], NORMAL * np.sqrt(runs[0][:, 1])
    measured = series[output.name]
    first, last = (round(at / series.sample_time) for at in (BEGIN, BEGIN + LENGTH))
    part = slice(first, last)
    time = series.sample_time * np.arange(first, last)
    figure = Figure(figsize=(9, 6), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(time, measured[part], '.', color='black', markersize=3, label='measured')
    for axes, centre in ((above, observed), (below, np.zeros(len(observed)))):
        axes.fill_between(time, (centre - band)[part], (centre + band)[part], color=COLOURS[1],
                          alpha=0.25, linewidth=0, label='observer, 95 %')
    below.plot(time, (measured - observed)[part], '.', color='black', markersize=4, zorder=3,
               label='measured')
    for name, prediction, colour in (('one step', predictor.one_step(series), COLOURS[0]),
                                     ('observer', observed, COLOURS[1])):
        for axes, centre in ((above, np.zeros(len(observed))), (below, observed)):
            axes.plot(time, (prediction - centre)[part], color=colour, linewidth=1.0, alpha=0.7,
                      label=name)
    above.set_ylabel(f'{output.meaning} [{output.unit}]')
    below.set(xlabel='time [s]', ylabel=f'less the observer [{output.unit}]')
    for axes in (above, below):
        axes.margins(x=0)
        axes.grid(alpha=0.3)
    above.legend(loc='lower left', bbox_to_anchor=(0, 1), ncols=4, frameon=False)
    write_picture(figure, args.picture)
    print(f'in the band: {", ".join(f"{100.0 * share:.0f}" for share in held)} % of each series, '
          f'{100.0 * np.mean(held):.0f} % in the mean')


if __name__ == '__main__':
    main()
