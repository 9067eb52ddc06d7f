"""Writes fleet.html, fleet.json and fleet.parquet."""
from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.files import write_whole, written_whole
from hydro_twin.fleet.page import page
from hydro_twin.fleet.summary import probability


def write_tables(fleet: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write the three files, each atomically; returns the fleet as it is.

    Raises:
        UserError: the folder cannot be written.
        ModuleNotFoundError: pyarrow is not installed.
    """
    try:
        write_parquet(fleet, folder / 'fleet.parquet')
        write_whole(folder / 'fleet.json', json.dumps(fleet, indent=1, allow_nan=False) + '\n')
        write_whole(folder / 'fleet.html', page(fleet))
    except OSError as error:
        raise UserError(f'{folder}: cannot be written ({error.strerror})') from error
    return fleet


def write_parquet(fleet: Mapping[str, Any], path: Path) -> None:
    """Write a row for each rig, period and parameter; a period without one has a single row."""
    import pyarrow as pa
    from pyarrow import parquet

    text = ('rig', 'plant', 'group', 'date', 'verdict', 'effects', 'key', 'report', 'problem',
            'parameter', 'unit')
    numbers = ('probability', 'error_before', 'error_after', 'noise', 'value', 'std_error',
               'usual_mean', 'usual_spread', 'shrunken', 'shrunken_error', 'score')
    labels = sorted({label for rig in fleet['rigs'] for label in rig['labels']})
    schema = pa.schema([
        *((name, pa.string()) for name in text), ('certain', pa.bool_()),
        *((name, pa.float64()) for name in numbers),
        *((f'label_{name}', pa.string()) for name in labels)])
    rows = [{**{f'label_{name}': value for name, value in rig['labels'].items()}, **row}
            for rig in fleet['rigs'] for row in _rows(rig, fleet['groups'][rig['group']])]
    with written_whole(path) as part:
        parquet.write_table(pa.Table.from_pylist(rows, schema=schema), part)


def _rows(rig: Mapping[str, Any], usual: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """List the rows of a rig; what compares it with its group stands at its last period."""
    same = {name: rig[name] for name in ('rig', 'plant', 'group')}
    rows = [{**same, 'date': problem['date'], 'problem': problem['reason']}
            for problem in rig['problems']]
    for period in rig['periods']:
        of_period = {
            **same, 'date': period['date'], 'verdict': period['verdict'],
            'effects': ' + '.join(f'{one["id"]} at {one["port"]}' for one in period['effects']),
            'certain': all(one['certain'] for one in period['effects'])
            if period['effects'] else None, 'probability': probability(period),
            'key': period['key'], 'report': period['report'], 'noise': period['noise'],
            'error_before': period['error']['before'], 'error_after': period['error']['after']}
        compared = {name: _compared(rig['usual'][name], usual[name]) for name in rig['usual']
                    } if period is rig['periods'][-1] else {}
        rows += [{**of_period, 'parameter': name, 'unit': usual.get(name, {}).get('unit'),
                  **period['estimates'].get(name, {}), **compared.get(name, {})}
                 for name in dict.fromkeys([*period['estimates'], *compared])] or [of_period]
    return rows


def _compared(own: Mapping[str, Any], usual: Mapping[str, Any]) -> dict[str, Any]:
    """Lay out where a rig stands in its group."""
    return {'usual_mean': usual['mean'], 'usual_spread': usual['spread'],
            'shrunken': own['value'], 'shrunken_error': own['std_error'], 'score': own['score']}
