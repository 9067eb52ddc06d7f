"""Puts the results of a fleet side by side: a row for each rig, and what is usual for a group."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import version
import math
from typing import Any

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.shrinkage import shrink, surprise
from hydro_twin.fleet.store import RESULTS
from hydro_twin.fleet.task import Outcome
from hydro_twin.plants.plant import FloatArray

TREND = 3.0             # score from which a trend is shown
PERIODS = 3             # at least, for a trend
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
        logarithm where `log`), number of rigs, unit.
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
            'unit': last[having[0]['rig']][name]['unit']}
        for k, rig in enumerate(having):
            mean = math.exp(found.values[k]) if log else float(found.values[k])
            rig['usual'][name] = {
                'value': mean, 'std_error': float(found.errors[k]) * (mean if log else 1.0),
                'score': None if np.isnan(found.scores[k]) else float(found.scores[k])}
    for rig in known if len(known) > 2 else ():
        for effect in rig['effects']:
            others = [other for other in known if other is not rig]
            score = surprise(sum(effect in other['effects'] for other in others), len(others))
            if score > 0.0:
                rig['rare'][effect] = score
    return usual


def _farthest(rig: Row) -> dict[str, Any] | None:
    """Return the score that is farthest from zero, and of what it is."""
    scores = {name: one['score'] for name, one in rig['usual'].items()
              if one['score'] is not None} | rig['rare']
    if not scores:
        return None
    name = max(scores, key=lambda name: abs(scores[name]))
    return {'name': name, 'value': scores[name]}


def _trend(rig: Row, usual: Mapping[str, Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return the clearest trend of a rig over its periods; None if none is clear."""
    found = []
    for name in dict.fromkeys(name for period in rig['periods'] for name in period['estimates']):
        points = [(_years(period['date']), period['estimates'][name]) for period in rig['periods']
                  if name in period['estimates'] and period['date']]
        time = np.array([when for when, _ in points])
        value, error = (np.array([point[what] for _, point in points])
                        for what in ('value', 'std_error'))
        if len(points) < PERIODS or np.ptp(time) == 0.0:
            continue
        log = bool((value > 0.0).all()) and usual.get(name, {}).get('log', True)
        slope, spread, score = line(time, np.log(value) if log else value,
                                    error / value if log else error)
        if abs(score) >= TREND:
            found.append({'name': name, 'log': log, 'score': score, 'std_error': spread,
                          'per_year': math.expm1(slope) if log else slope,
                          'unit': points[0][1]['unit']})
    return max(found, key=lambda one: abs(one['score']), default=None)


def line(x: FloatArray, y: FloatArray, s: FloatArray) -> tuple[float, float, float]:
    """Fit a straight line by weighted least squares.

    Where the points scatter more than their standard errors say, these are taken as too small by
    one factor (R. T. Birge, Phys. Rev. 40 (1932) 207-227).

    Args:
        x: (n,), n >= 3.
        y: (n,).
        s: (n,), standard errors.

    Returns:
        (slope, its standard error, score): the quantile of the normal distribution with the
        p-value of the slope, of Student's distribution where the factor was estimated.
    """
    w = s ** -2
    x = x - np.average(x, weights=w)
    squares = float(w @ x ** 2)
    mean = np.average(y, weights=w)
    slope = float(w @ (x * y)) / squares
    free = len(x) - 2
    ratio = float(w @ (y - mean - slope * x) ** 2) / free
    error = math.sqrt(max(1.0, ratio) / squares)
    over = abs(slope) / error
    score = over if ratio <= 1.0 else float(norm.isf(max(student.sf(over, free), 1e-300)))
    return slope, error, math.copysign(score, slope)


def _years(date: str) -> float:
    """Count years to a date."""
    return datetime.fromisoformat(date).timestamp() / YEAR if date else math.nan
