"""The verbs: each found by its value in a file of this folder, or by an entry point."""
from __future__ import annotations

from hydro_twin.commands.verb import Command
from hydro_twin.plugins import in_folder, plugin_named, plugin_names, registered

FOLDER = 'hydro_twin.commands'
GROUP = 'hydro_twin.verbs'      # entry points: the studies' verbs and those of other packages


def verbs() -> dict[str, Command]:
    """Return all verbs by name.

    Raises:
        UserError: one of another package cannot be loaded.
    """
    return registered(FOLDER, Command, GROUP)


def verb_named(name: str) -> Command | None:
    """Return the verb of that name, without loading those of other packages; None if none is.

    Raises:
        UserError: another package brings it, and it cannot be loaded.
    """
    ours = in_folder(FOLDER, Command)
    if name in ours or name not in plugin_names(GROUP):
        return ours.get(name)
    return plugin_named(GROUP, name, Command)
