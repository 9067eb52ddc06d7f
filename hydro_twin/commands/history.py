"""hydro-twin history: the line of descent of the models in a store."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.verb import Verb

if TYPE_CHECKING:
    from rich.console import Console

COLUMNS = ('version', 'when', 'alias', 'parent', 'captured', 'verdict', 'changed')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('store', type=Path, metavar='STORE', help='folder of the versions')
    parser.add_argument('--html', type=Path, metavar='FILE',
                        help='a page to make: each parameter and effect over time')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """List the versions, and draw their parameters.

    Returns:
        The versions, the oldest first, and the page if one was made.
    """
    from hydro_twin.files import write_whole
    from hydro_twin.store.history import courses, plain, rows
    from hydro_twin.store.store import Store
    from hydro_twin.store.version import StoreError

    store = Store.opened(args.store)
    found = rows(store)
    result: dict[str, Any] = {'store': str(args.store), 'versions': [plain(row) for row in found]}
    if args.html:
        from hydro_twin.report.history import history_page

        if not found:
            raise StoreError(f'{args.store}: no versions to draw')
        write_whole(args.html, history_page(args.store.resolve().name, found,
                                            courses(store.versions())))
        result['html'] = str(args.html)
    return result


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    from rich.table import Table

    table = Table()
    for column in COLUMNS:
        table.add_column(column, no_wrap=column in ('version', 'when', 'alias'))
    for row in result['versions']:
        short = {**row, 'when': row['when'][:16].replace('T', ' ')}
        table.add_row(*(short[column] for column in COLUMNS))
    console.print(table)
    if 'html' in result:
        console.print(f'page written to {result["html"]}')


VERB = Verb('history', 'list the models of a store: what became of each, and what changed',
            add_arguments, run, show)
