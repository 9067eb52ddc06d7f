"""What a chart shows, for the page and for pictures alike."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hydro_twin.arrays import FloatArray

MEASURED, BEFORE, AFTER, QUIET = '#222222', '#d95f02', '#1b9e77', '#8a8a8a'
FOUND = '#7570b3'
DIGITS = 6


@dataclass(frozen=True)
class Curve:
    """Points (x, y) of one kind; a y that is not finite leaves a gap.

    Attributes:
        kind: 'line', 'thick', 'dash', 'dots' (many small ones) or 'points' (few, with bars of
            +-error).
    """

    label: str
    x: FloatArray
    y: FloatArray
    colour: str
    kind: Literal['line', 'thick', 'dash', 'dots', 'points'] = 'line'
    error: FloatArray | None = None


@dataclass(frozen=True)
class Chart:
    """Curves over one pair of axes.

    Attributes:
        log: whether both axes are logarithmic.
        height: as a share of the usual one.
    """

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    log: bool = False
    height: float = 1.0


@dataclass(frozen=True)
class View:
    """Charts one above the other over the same x."""

    label: str
    charts: tuple[Chart, ...]


@dataclass(frozen=True)
class Illustration:
    """A figure of the page; where there are several views, the reader chooses.

    Attributes:
        name: of its picture file.
    """

    name: str
    title: str
    caption: str
    views: tuple[View, ...]


def axis(what: str, unit: str) -> str:
    """Label an axis; a ratio has no unit."""
    return what if unit == '1' else f'{what} [{unit}]'


def envelope(x: FloatArray, y: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Keep the least and the largest of every few samples, so that at most `most` points are left.

    Args:
        x: evenly spaced, (N,).
        y: (N,).
        most: number of points.
    """
    size = 2 * int(np.ceil(len(y) / most))
    if len(y) <= most:
        return x, y
    whole = np.pad(y, (0, -len(y) % size), mode='edge').reshape(-1, size)
    pairs = np.stack([whole.min(axis=1), whole.max(axis=1)], axis=1)
    falling = whole.argmin(axis=1) > whole.argmax(axis=1)
    pairs[falling] = pairs[falling, ::-1]
    step = (x[1] - x[0]) * size / 2.0
    return x[0] + step * np.arange(pairs.size), pairs.ravel()


def plain(illustration: Illustration) -> dict[str, Any]:
    """Lay out a figure for the page's script."""
    return {'views': [{'label': view.label, 'charts': [
        {'xLabel': chart.x_label, 'yLabel': chart.y_label, 'log': chart.log,
         'height': chart.height, 'curves': [_plain(curve) for curve in chart.curves]}
        for chart in view.charts]} for view in illustration.views]}


def _plain(curve: Curve) -> dict[str, Any]:
    drawn = {'label': curve.label, 'colour': curve.colour, 'kind': curve.kind,
             'x': _places(curve.x), 'y': numbers(curve.y)}
    return drawn if curve.error is None else {**drawn, 'error': numbers(curve.error)}


def _places(x: FloatArray) -> list[float | None] | dict[str, float]:
    """Write evenly spaced places as their start and step."""
    steps = np.diff(x)
    if len(x) > 2 and np.ptp(steps) < 1e-6 * abs(steps[0]):
        return {'start': float(x[0]), 'step': float(x[-1] - x[0]) / (len(x) - 1)}
    return numbers(x)


def numbers(values: Sequence[float] | FloatArray) -> list[float | None]:
    """Round to the digits that a chart can show; None where not finite."""
    return [float(f'{value:.{DIGITS}g}') if np.isfinite(value) else None
            for value in np.asarray(values).tolist()]
