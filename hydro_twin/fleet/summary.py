"""Puts the results of a fleet side by side: a row for each rig, and the mean of each group."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
import math
from typing import Any

from hydro_twin.fleet.group import compare
from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.scores import limit
from hydro_twin.fleet.store import RESULTS
from hydro_twin.fleet.task import Outcome
from hydro_twin.fleet.trend import effect_name, Row, trend_of


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
        row['trend'] = trend_of(row, usual[row['group']])
    for period in (period for row in rows for period in row['periods']):
        del period['factor']        # it is in results/, and of no use for a person
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
             if name.startswith(f'{effect_name(effect)}: ')]
    return {**rig,
            'verdict': last['verdict'] if last else 'failed',
            'says': last['says'] if last else rig['problems'][-1]['reason'],
            'effects': [effect_name(effect) for effect in effects],
            'certain': all(effect['certain'] for effect in effects) if effects else None,
            'probability': probability(last) if last else None,
            'sizes': sizes, 'report': last['report'] if last else None,
            'usual': {}, 'rare': {}, 'pooled': 0}


def probability(period: Mapping[str, Any]) -> float:
    """Return the probability of the effects, the least of several; without, of nothing missing."""
    return float(min((effect['probability'] for effect in period['effects']),
                     default=period['nothing']))


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
