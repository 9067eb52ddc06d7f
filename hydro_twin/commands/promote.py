"""hydro-twin promote: makes a version of a store the champion."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.verb import Verb
from hydro_twin.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

PERSON = 'a person'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('store', type=Path, metavar='STORE', help='folder of the versions')
    parser.add_argument('wanted', nargs='?', metavar='VERSION',
                        help='a number (default: the challenger)')
    parser.add_argument('--model', type=Path, metavar='MODEL',
                        help='a model file to enter as a new version first; creates the store '
                        'if there is none')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Promote it.

    Returns:
        The store, the version that is champion now, its model file and what changed.
    """
    from hydro_twin.store.store import Store
    from hydro_twin.store.version import CHALLENGER

    if args.model and args.wanted:
        raise UserError('give a VERSION or a --model, not both')
    if args.model:
        store = Store(args.store)
        name = store.enter(args.model, PERSON).name
    else:
        store = Store.opened(args.store)
        name = args.wanted or CHALLENGER
    version = store.promote(name, PERSON)
    return {'store': str(args.store), 'champion': version.name, 'model': str(version.model_file),
            'changed': version.record['changed']}


def show(result: dict[str, Any], console: Console) -> None:
    """Print it."""
    console.print(f'version {result["champion"]} is the champion: {result["changed"]}')


VERB = Verb('promote', 'make a version of a store the champion, which the twin runs',
            add_arguments, run, show)
