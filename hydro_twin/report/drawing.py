"""The page's figures as pictures."""
from __future__ import annotations

import io

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from hydro_twin.report.chart import Chart, Curve, Illustration

HEIGHT = 3.2                                # inches, of a usual chart


def png(illustration: Illustration) -> bytes:
    """Draw a figure as a PNG file; the same figure gives the same bytes."""
    file = io.BytesIO()
    draw(illustration).savefig(file, format='png', dpi=110, metadata={'Software': None})
    return file.getvalue()


def draw(illustration: Illustration) -> Figure:
    """Draw what the page shows when it is opened."""
    charts = illustration.views[0].charts
    heights = [chart.height for chart in charts]
    figure = Figure(figsize=(9.0, HEIGHT * sum(heights) + 0.4), layout='constrained')
    figure.suptitle(f'{illustration.title}: {illustration.views[0].label}'
                    if len(illustration.views) > 1 else illustration.title)
    grid = figure.subplots(len(charts), 1, sharex=True, height_ratios=heights, squeeze=False)
    for axes, chart in zip(grid[:, 0], charts, strict=True):
        _draw(axes, chart)
    grid[-1, 0].set_xlabel(charts[-1].x_label)
    return figure


def _draw(axes: Axes, chart: Chart) -> None:
    for curve in chart.curves:
        _plot(axes, curve)
    if chart.log:
        axes.set(xscale='log', yscale='log')
        for axis in (axes.xaxis, axes.yaxis):   # as formulas, matplotlib loses 15 kB a figure
            axis.set_major_formatter('{x:g}')
            axis.set_minor_formatter(LogFormatter())
    axes.set_ylabel(chart.y_label)
    axes.margins(x=0.01)
    axes.grid(alpha=0.3)
    axes.legend(loc='lower left', bbox_to_anchor=(0, 1), ncols=4, frameon=False)


def _plot(axes: Axes, curve: Curve) -> None:
    if curve.kind == 'points':
        axes.errorbar(curve.x, curve.y, curve.error, color=curve.colour, label=curve.label,
                      marker='o', markersize=5, linestyle='none', capsize=2)
    elif curve.kind == 'dots':
        axes.plot(curve.x, curve.y, color=curve.colour, label=curve.label, marker='.',
                  markersize=3, linestyle='none')
    else:
        axes.plot(curve.x, curve.y, color=curve.colour, label=curve.label,
                  linewidth=3.0 if curve.kind == 'thick' else 1.2,
                  linestyle='--' if curve.kind == 'dash' else '-')
