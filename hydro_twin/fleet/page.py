"""The page of a fleet, for a person: one file that needs no other, rows that can be sorted."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydro_twin.report.page import environment, NOT_KNOWN, probability, short, spread

PANELS = 6              # small multiples of a rig at most: the parameters that most rigs have
REPORTS = 12            # links to periods of a rig at most, the last ones
ROWS = 50               # that are laid out as the page opens; the others as it is scrolled
DIGITS = 5


def page(fleet: Mapping[str, Any]) -> str:
    """Write the page of a fleet, given as fleet.json has it."""
    pages = environment('fleet')
    pages.filters |= {'short': short, 'spread': spread, 'p': probability, 'change': change,
                      'unit': unit, 'between': between}
    panels = {group: sorted(usual, key=lambda name: -usual[name]['rigs'])[:PANELS]
              for group, usual in fleet['groups'].items()}
    return pages.get_template('fleet_page.html').render(
        fleet=fleet, rigs=fleet['rigs'], groups=fleet['groups'], reports=REPORTS, rows=ROWS,
        labels=sorted({label for rig in fleet['rigs'] for label in rig['labels']}),
        count={'out': sum(bool(rig['score']) and rig['score']['out'] for rig in fleet['rigs']),
               'failed': sum(bool(rig['problems']) for rig in fleet['rigs'])},
        width=max(map(len, panels.values()), default=0), data=_data(fleet, panels))


def _data(fleet: Mapping[str, Any], panels: Mapping[str, list[str]]) -> dict[str, Any]:
    """Collect what the small multiples are drawn of, few digits each."""
    groups = {}
    for group, names in panels.items():
        usual = fleet['groups'][group]
        groups[group] = [{'name': name, **{key: _few(usual[name][key]) for key in
                                           ('log', 'mean', 'spread')}} for name in names]
    rigs = [{'group': rig['group'], 'out': [
        rig['usual'].get(name, {}).get('out', False) for name in panels[rig['group']]], 'points': [
        [[period['date'][:10], _few(one['value']), _few(one['std_error'])]
         for period in rig['periods'] if (one := period['estimates'].get(name))]
        for name in panels[rig['group']]]} for rig in fleet['rigs']]
    return {'groups': groups, 'rigs': rigs}


def _few(value: float) -> float:
    """Round to a few digits."""
    return value if isinstance(value, bool) else float(f'{value:.{DIGITS}g}')


def change(trend: Mapping[str, Any]) -> str:
    """Write how much something changes in a year."""
    if not trend['log']:
        return f'{trend["per_year"]:+.3g}{unit(trend["unit"])} a year'
    return (f'× {1.0 + trend["per_year"]:.3g} a year' if trend['per_year'] >= 1.0 else
            f'{100.0 * trend["per_year"]:+.3g} % a year')


def between(usual: Mapping[str, Any]) -> str:
    """Write the spread of a parameter between rigs."""
    if usual['rigs'] < 2:
        return NOT_KNOWN
    return f'{100.0 * usual["spread"]:.2g} %' if usual['log'] else f'{usual["spread"]:.2g}'


def unit(text: str) -> str:
    """Write a unit behind a number."""
    return '' if text == '1' else f' {text}'
