"""hydro-twin schema: the JSON Schema of a file, for editors and other programs."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.verb import Verb

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('document', choices=('model', 'report', 'config', 'map'),
                        help="a model file, a trace's report.json, a configuration, or the map "
                        'of a table')
    parser.add_argument('-o', '--output', type=Path, metavar='FILE', help='a file to write it to')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Return the schema, and write it where that is asked for."""
    import json

    from hydro_twin.files import write_whole
    from hydro_twin.schema import json_schema

    schema = json_schema(args.document)
    if args.output:
        write_whole(args.output, json.dumps(schema, indent=2) + '\n')
    return schema


def show(result: dict[str, Any], console: Console) -> None:
    """Print it."""
    console.print_json(data=result)


VERB = Verb('schema', 'print the JSON Schema of a file, for editors', add_arguments, run, show)
