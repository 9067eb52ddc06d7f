"""hydro-twin rollback: makes the champion's predecessor the champion again."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.verb import Verb

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('store', type=Path, metavar='STORE', help='folder of the versions')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Go back.

    Returns:
        The store, the version that is champion now, and its model file.
    """
    from hydro_twin.commands.promote import PERSON
    from hydro_twin.store.store import Store

    version = Store.opened(args.store).roll_back(PERSON)
    return {'store': str(args.store), 'champion': version.name, 'model': str(version.model_file)}


def show(result: dict[str, Any], console: Console) -> None:
    """Print it."""
    console.print(f'version {result["champion"]} is the champion again')


VERB = Verb('rollback', 'make the predecessor of the champion of a store the champion again',
            add_arguments, run, show)
