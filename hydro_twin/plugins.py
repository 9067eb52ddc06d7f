"""What other packages bring: plants, effects and the like, by entry points."""
from __future__ import annotations

from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hydro_twin.errors import UserError


def plugins(group: str) -> list[Any]:
    """Load the objects that installed packages register under an entry point group.

    Args:
        group: 'hydro_twin.plants', 'hydro_twin.effects', ...

    Raises:
        UserError: one cannot be loaded; the message names its package.
    """
    found = []
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        try:
            found.append(entry.load())
        except Exception as error:      # whatever the import of a foreign module raises
            package = entry.dist.name if entry.dist else 'a package'
            raise UserError(f'{package} registers {entry.value} as one of {group}, which cannot '
                            f'be loaded: {error}') from error
    return found


def plugin_files(group: str) -> list[Path]:
    """List the source files of what is registered under a group, without loading it."""
    specs = [find_spec(entry.module) for entry in entry_points(group=group)]
    return [Path(spec.origin) for spec in specs if spec is not None and spec.origin]
