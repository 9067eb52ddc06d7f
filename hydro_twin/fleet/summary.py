"""Puts the results of a fleet side by side: a row for each rig, and what is usual for a group."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
import math
from typing import Any

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.shrinkage import limit, shrink, surprise
from hydro_twin.fleet.store import RESULTS
from hydro_twin.fleet.task import Outcome
from hydro_twin.plants.plant import FloatArray

TREND = 3.0             # score from which a trend is shown
PERIODS = 3             # at least, for a trend
RIGS = 3                # at least, to say how well a measurement repeats
YEAR = 365.25 * 86400.0  # [s]

Row = dict[str, Any]


def summarise(done: Sequence[tuple[Task, Outcome]]) -> dict[str, Any]:
    """Lay out what came of all tasks, in the order of rigs and dates, as fleet.json has it.

    Rigs are compared within their group by the last result of each. Those farthest from their
    group come first.
    """
    rigs: dict[str, Row] = {}
    for task, outcome in done:
        rig = rigs.setdefault(task.rig, {
            'rig': task.rig, 'plant': task.plant, 'group': task.group,
            'labels': {}, 'periods': [], 'problems': [], 'last_bag': None})
        rig['labels'] |= dict(task.labels)
        rig['last_bag'] = task.date or rig['last_bag']
        if outcome.record is None:
            rig['problems'].append({'date': task.date, 'reason': outcome.reason})
        else:
            rig['periods'].append({
                'date': task.date, 'key': outcome.key,
                'report': f'{RESULTS}/{outcome.key}/report.html', **outcome.record})
    rows = [_state(rig) for rig in rigs.values()]
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row['group'], []).append(row)
    usual = {group: compare(members) for group, members in sorted(groups.items())}
    _mark(rows, usual)
    for row in rows:
        row['score'] = _farthest(row)
        row['trend'] = _trend(row, usual[row['group']])
    rows.sort(key=lambda row: -abs(row['score']['value']) if row['score'] else math.inf)
    return {
        'version': version('hydro_twin'), 'rigs': rows, 'groups': usual,
        'traces': {'done': sum(outcome.record is not None for _, outcome in done),
                   'traced_now': sum(outcome.traced for _, outcome in done),
                   'failed': sum(outcome.record is None for _, outcome in done)},
    }


def _state(rig: Row) -> Row:
    """Add what the last result of a rig says."""
    last = rig['periods'][-1] if rig['periods'] else None
    effects = last['effects'] if last else []
    sizes = [{'name': name, **values} for effect in effects
             for name, values in (last['estimates'] if last else {}).items()
             if name.startswith(f'{_id(effect)}: ')]
    return {**rig,
            'verdict': last['verdict'] if last else 'failed',
            'says': last['says'] if last else rig['problems'][-1]['reason'],
            'effects': [_id(effect) for effect in effects],
            'certain': all(effect['certain'] for effect in effects) if effects else None,
            'sizes': sizes, 'report': last['report'] if last else None,
            'usual': {}, 'rare': {}}


def _id(effect: Mapping[str, Any]) -> str:
    """Name an effect with its place, as the estimates do."""
    return f'{effect["id"]} at {effect["port"]}'


def compare(rigs: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Compare the rigs of a group, parameter by parameter; adds to each rig where it stands.

    A parameter is taken by its logarithm where it is above zero for all, else as it is.

    Args:
        rigs: rows; 'usual' gets the shrunken values and the scores, 'rare' the scores of effects
            that few others have.

    Returns:
        Parameter -> what is usual: mean (geometric where `log`), spread between rigs (of the
        logarithm where `log`), number of rigs, of those kept, unit, repeatability.
    """
    known = [rig for rig in rigs if rig['periods']]
    last = {rig['rig']: rig['periods'][-1]['estimates'] for rig in known}
    usual: dict[str, dict[str, Any]] = {}
    for name in dict.fromkeys(name for estimates in last.values() for name in estimates):
        having = [rig for rig in known if name in last[rig['rig']]]
        value, error = (np.array([last[rig['rig']][name][what] for rig in having])
                        for what in ('value', 'std_error'))
        log = bool((value > 0.0).all())
        found = shrink(np.log(value), error / value) if log else shrink(value, error)
        usual[name] = {
            'log': log, 'mean': math.exp(found.mean) if log else found.mean,
            'std_error': found.std_error, 'spread': found.spread, 'rigs': len(having),
            'kept': int(found.kept.sum()),
            'unit': last[having[0]['rig']][name]['unit'],
            'repeatability': repeatability(known, name, log)}
        for k, rig in enumerate(having):
            mean = math.exp(found.values[k]) if log else float(found.values[k])
            rig['usual'][name] = {
                'value': mean, 'std_error': float(found.errors[k]) * (mean if log else 1.0),
                'score': None if np.isnan(found.scores[k]) else float(found.scores[k]),
                'out': False}
    for rig in known if len(known) > 2 else ():
        for effect in rig['effects']:
            others = [other for other in known if other is not rig]
            score = surprise(sum(effect in other['effects'] for other in others), len(others))
            if score > 0.0:
                rig['rare'][effect] = score
    return usual


def _mark(rigs: Sequence[Row], usual: Mapping[str, Mapping[str, Any]]) -> None:
    """Mark the scores that stand out, for as many comparisons as there are in the fleet."""
    scores = [(one, usual[rig['group']][name]['kept']) for rig in rigs
              for name, one in rig['usual'].items() if one['score'] is not None]
    limits = {kept: limit(len(scores), kept) for _, kept in scores}
    for one, kept in scores:
        one['out'] = abs(one['score']) >= limits[kept]


def _farthest(rig: Row) -> dict[str, Any] | None:
    """Return the score that is farthest from zero, of what it is, and whether it stands out."""
    scores = {name: one['score'] for name, one in rig['usual'].items()
              if one['score'] is not None} | rig['rare']
    if not scores:
        return None
    name = max(scores, key=lambda name: abs(scores[name]))
    return {'name': name, 'value': scores[name],
            'out': bool(rig['usual'].get(name, {}).get('out', False))}


def _trend(rig: Row, usual: Mapping[str, Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return the clearest trend of a rig over its periods; None if none is clear."""
    found = []
    for name, one in usual.items():
        if (points := _over_time(rig, name, one['log'])) is None:
            continue
        slope, error, score = line(*points).scored(one['repeatability'])
        if abs(score) >= TREND:
            found.append({'name': name, 'log': one['log'], 'score': score, 'std_error': error,
                          'per_year': math.expm1(slope) if one['log'] else slope,
                          'unit': one['unit']})
    return max(found, key=lambda one: abs(one['score']), default=None)


def repeatability(rigs: Sequence[Row], name: str, log: bool) -> float | None:
    """Say how much more a parameter scatters from period to period than its standard errors say.

    Two recordings of a rig differ by more than the noise within each: it is warmer, or moves
    otherwise. Few periods of one rig do not show by how much; those of its group do. The median
    over the rigs leaves out one that does not follow a line.

    Returns:
        The factor for the variance, one at least; None from fewer than three rigs.
    """
    lines = [line(*points) for rig in rigs
             if (points := _over_time(rig, name, log)) is not None]
    ratios = [one.ratio * one.free / chi2.median(one.free) for one in lines]
    return max(1.0, float(np.median(ratios))) if len(ratios) >= RIGS else None


def _over_time(rig: Row, name: str, log: bool) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return time [years], values and standard errors of a parameter; None if too few.

    Only of periods with the effects of the last: what a model lacks bends its other parameters.
    """
    points = [(datetime.fromisoformat(period['date']).timestamp() / YEAR, one['value'],
               one['std_error']) for period in rig['periods']
              if (one := period['estimates'].get(name)) and period['date']
              and list(map(_id, period['effects'])) == rig['effects']
              and (one['value'] > 0.0 or not log)]
    if len(points) < PERIODS or len({when for when, _, _ in points}) < PERIODS:
        return None
    time, value, error = np.array(points).T
    return (time, np.log(value), error / value) if log else (time, value, error)


@dataclass(frozen=True)
class Line:
    """A straight line through the periods of a rig.

    Attributes:
        slope: a year.
        std_error: of the slope, as the standard errors of the points have it.
        ratio: of the squares of the residuals to what the standard errors say.
        free: degrees of freedom.
    """

    slope: float
    std_error: float
    ratio: float
    free: int

    def scored(self, factor: float | None) -> tuple[float, float, float]:
        """Return the slope, its standard error, and its score, a quantile of the normal.

        Args:
            factor: for the variance of the points; None: by how much they scatter, with
                Student's distribution, since that is then known from few points only
                (R. T. Birge, Phys. Rev. 40 (1932) 207-227).
        """
        if factor is not None:
            error = self.std_error * math.sqrt(factor)
            return self.slope, error, self.slope / error
        error = self.std_error * math.sqrt(max(1.0, self.ratio))
        tail = student.sf(abs(self.slope) / error, self.free)
        return self.slope, error, math.copysign(float(norm.isf(max(tail, 1e-300))), self.slope)


def line(x: FloatArray, y: FloatArray, s: FloatArray) -> Line:
    """Fit a straight line by weighted least squares.

    Args:
        x: (n,), n >= 3.
        y: (n,).
        s: (n,), standard errors.
    """
    w = s ** -2
    x = x - np.average(x, weights=w)
    squares = float(w @ x ** 2)
    mean = np.average(y, weights=w)
    slope = float(w @ (x * y)) / squares
    free = len(x) - 2
    return Line(slope, squares ** -0.5, float(w @ (y - mean - slope * x) ** 2) / free, free)
