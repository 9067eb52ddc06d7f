"""The page of a store: its line of descent, and each parameter and effect over time."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_twin.report.chart import (
    AFTER,
    axis,
    Chart,
    Curve,
    Illustration,
    plain,
    QUIET,
    View,
)
from hydro_twin.report.page import environment, short, spread
from hydro_twin.store.history import Course, Row

SPANS = (('days', 1.0), ('hours', 24.0), ('minutes', 1440.0))    # unit, how many a day has


def history_page(name: str, rows: Sequence[Row], courses: Sequence[Course]) -> str:
    """Write the history of a store as one self-contained page.

    Args:
        name: of the store.
        rows: its versions, the oldest first.
        courses: of the parameters of the plant and of the effects.
    """
    last = max(course.days[-1] for course in courses) if courses else 0.0
    unit, scale = next((span for span in SPANS if last * span[1] >= 2.0), SPANS[-1])
    drawn = [illustration(k, course, scale, unit) for k, course in enumerate(courses)]
    return environment().get_template('history.html').render(
        name=name, rows=rows, courses=list(zip(courses, drawn, strict=True)),
        champion=next((row for row in rows if row.alias == 'champion'), None),
        short=short, spread=spread, data={one.name: plain(one) for one in drawn})


def illustration(index: int, course: Course, scale: float, time: str) -> Illustration:
    """Draw a parameter over time; bars are two standard errors, where they are known.

    Args:
        index: of the figure on the page.
        course: of the parameter.
        scale: how many of the unit of the time axis a day has.
        time: that unit.
    """
    days = scale * np.array(course.days)
    values = np.array([one.value for one in course.values])
    known = np.array([one.std_error is not None for one in course.values])
    errors = np.array([2.0 * (one.std_error or 0.0) for one in course.values])
    curves = [Curve('in the order of entry', days, values, QUIET)]
    if known.any():
        curves.append(Curve('with two standard errors', days[known], values[known], AFTER,
                            'points', errors[known]))
    if not known.all():
        curves.append(Curve('error not known', days[~known], values[~known], QUIET, 'points',
                            errors[~known]))
    unit = course.values[-1].unit
    return Illustration(
        f'course_{index}', course.name, f'Versions {", ".join(course.versions)}.',
        (View('', (Chart(f'{time} since the first version', axis(course.name, unit),
                         tuple(curves), height=0.7),)),))
