"""Mean and spread of a group of rigs, and where each of them stands in it."""
from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fleet.factors import Rows, rows_of, together
from hydro_twin.fleet.prior import fit_prior
from hydro_twin.fleet.scores import compare_each, surprise
from hydro_twin.fleet.trend import repeatability, Row, same_effects

CHANGED = 0.05          # chance of a difference from which an earlier period counts no more


def compare(rigs: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Compare the rigs of a group; adds to each where it stands.

    A parameter is taken by its logarithm where it is above zero for all, else as it is.

    Args:
        rigs: rows; 'usual' gets the values with the group and the scores, 'rare' the scores of
            effects that few others have, 'pooled' the number of periods that the values are of.

    Returns:
        Parameter -> its mean in the group (geometric where `log`), spread between rigs (of the
        logarithm where `log`), number of rigs, of those kept, unit, repeatability.
    """
    known = [rig for rig in rigs if rig['periods']]
    last = {rig['rig']: rig['periods'][-1]['estimates'] for rig in known}
    usual: dict[str, dict[str, Any]] = {}
    scale = []
    for name in dict.fromkeys(name for estimates in last.values() for name in estimates):
        having = [rig for rig in known if name in last[rig['rig']]]
        value, error = (np.array([last[rig['rig']][name][what] for rig in having])
                        for what in ('value', 'std_error'))
        log = bool((value > 0.0).all())
        found = compare_each(*(np.log(value), error / value) if log else (value, error))
        usual[name] = {'log': log, 'rigs': len(having), 'kept': int(found.kept.sum()),
                       'unit': last[having[0]['rig']][name]['unit'],
                       'repeatability': repeatability(known, name, log)}
        scale.append(1.0 if log else float(np.abs(value).max()))
        for rig, score, kept in zip(having, found.scores, found.kept, strict=True):
            rig['usual'][name] = {'score': None if np.isnan(score) else float(score),
                                  'kept': bool(kept), 'out': False}
    if usual:
        _borrow(known, usual, np.array(scale))
    for rig in known if len(known) > 2 else ():
        for effect in rig['effects']:
            others = [other for other in known if other is not rig]
            score = surprise(sum(effect in other['effects'] for other in others), len(others))
            if score > 0.0:
                rig['rare'][effect] = score
    return usual


def _borrow(rigs: Sequence[Row], usual: dict[str, dict[str, Any]], scale: FloatArray) -> None:
    """Estimate mean and spread from all rigs, and each rig with them.

    A rig that stands out in a parameter neither counts for the mean of it nor borrows. One whose
    recording does not determine a parameter by itself borrows that, too.
    """
    names, logs = list(usual), [one['log'] for one in usual.values()]
    own = [[k for k, name in enumerate(names)
            if name in rig['usual'] and not rig['usual'][name]['kept']] for rig in rigs]
    rows = [recordings(rig, names, logs) for rig in rigs]
    prior = fit_prior([
        one.without(apart, one.solve()[0][apart], [logs[k] for k in apart])
        for one, apart in zip(rows, own, strict=True)], scale)
    for k, name in enumerate(names):
        usual[name] |= {'mean': math.exp(prior.mean[k]) if logs[k] else float(prior.mean[k]),
                        'std_error': float(prior.covariance[k, k]) ** 0.5,
                        'spread': float(prior.spread[k])}
    for rig, one, apart in zip(rigs, rows, own, strict=True):
        values, errors = prior.with_rig(one, apart)
        factor = rig['periods'][-1]['factor']
        for k, name in enumerate(names):
            if name in factor['names']:
                value = math.exp(values[k]) if logs[k] else float(values[k])
                rig['usual'].setdefault(name, {'score': None, 'kept': True, 'out': False})
                rig['usual'][name] |= {
                    'value': value, 'std_error': float(errors[k]) * (value if logs[k] else 1.0)}


def recordings(rig: Row, names: Sequence[str], logs: Sequence[bool]) -> Rows:
    """Combine the last period of a rig with those before, as long as these agree with it."""
    *earlier, last = [rows_of(period['factor'], names, logs) for period in same_effects(rig)]
    rig['pooled'] = 1
    for period in reversed(earlier):
        both, chance = together([last, period])
        if chance < CHANGED:
            break
        last = both
        rig['pooled'] += 1
    return last
