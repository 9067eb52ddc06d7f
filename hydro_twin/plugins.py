"""What other packages provide: plants, effects and more, by entry points."""
from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
import pkgutil
from typing import Protocol, TYPE_CHECKING

from hydro_twin.errors import UserError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


class Named(Protocol):
    """What can be registered."""

    @property
    def name(self) -> str:
        """What users call it."""
        ...


def registered[T: Named](package: str, kind: type[T], group: str) -> dict[str, T]:
    """Collect the values of a kind: those in the modules of a package, then those of others.

    Args:
        package: whose modules are all imported, in the order of their names.
        kind: type of the values; a module may define any number.
        group: of the entry points of other packages.

    Returns:
        The values by name.

    Raises:
        UserError: an entry point cannot be loaded or is of another type, or two values have one
            name.
    """
    found = in_folder(package, kind)
    for value in plugins(group, kind):
        if found.setdefault(value.name, value) is not value:
            raise UserError(f'two of {group} are named {value.name}')
    return found


def in_folder[T: Named](package: str, kind: type[T]) -> dict[str, T]:
    """Collect the values of a kind in the modules of a package; see `registered`."""
    modules = [import_module(f'{package}.{module.name}')
               for module in pkgutil.iter_modules(import_module(package).__path__)]
    return {value.name: value for module in modules for value in vars(module).values()
            if isinstance(value, kind)}


def plugins[T](group: str, kind: type[T]) -> list[T]:
    """Load what installed packages register under an entry point group, by name.

    Args:
        group: 'hydro_twin.plants', 'hydro_twin.effects', ...
        kind: type that each must be.

    Raises:
        UserError: one cannot be loaded, or is of another type; the message names its package.
    """
    return [_loaded(entry, group, kind) for entry in _entries(group)]


def _entries(group: str) -> list[EntryPoint]:
    """List the entry points of a group by name."""
    from importlib.metadata import entry_points  # slow to import, and a verb of ours needs none

    return sorted(entry_points(group=group), key=lambda entry: entry.name)


def _loaded[T](entry: EntryPoint, group: str, kind: type[T]) -> T:
    about = (f'{entry.dist.name if entry.dist else "a package"} registers {entry.value} as one '
             f'of {group}')
    try:
        value = entry.load()
    except Exception as error:      # whatever the import of a third-party module raises
        raise UserError(f'{about}, which cannot be loaded: {error}') from error
    if not isinstance(value, kind):
        raise UserError(f'{about}, which is no {kind.__name__}')
    return value


def plugin_names(group: str) -> list[str]:
    """List the names that installed packages register under a group, without loading any."""
    return [entry.name for entry in _entries(group)]


def plugin_named[T](group: str, name: str, kind: type[T]) -> T:
    """Load what is registered under a name of a group.

    Raises:
        UserError: it cannot be loaded, or is of another type.
    """
    entry = next(entry for entry in _entries(group) if entry.name == name)
    return _loaded(entry, group, kind)


def plugin_files(group: str) -> list[Path]:
    """List the source files of what is registered under a group, without loading it."""
    specs = [find_spec(entry.module) for entry in _entries(group)]
    return [Path(spec.origin) for spec in specs if spec is not None and spec.origin]
