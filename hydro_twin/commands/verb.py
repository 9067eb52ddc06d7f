"""A verb of the command line: what the registry holds of each, one file a verb."""
from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Command:
    """What every verb has.

    Attributes:
        name: what is typed.
        summary: what it does, for --help.
    """

    name: str
    summary: str


@dataclass(frozen=True)
class Verb(Command):
    """A verb. Its module imports nothing heavy at its top: that belongs in `run`.

    Attributes:
        add_arguments: adds its own arguments to a parser; `--json` is added for every verb.
        run: does the work and returns the object that `--json` prints. It may hold numpy scalars
            and arrays, paths and NaN (printed as null). It prints nothing; progress goes to
            standard error (`hydro_twin.progress`). What goes wrong is raised.
        show: prints the same object for a person.
    """

    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], dict[str, Any]]
    show: Callable[[dict[str, Any], Console], None]


@dataclass(frozen=True)
class RosVerb(Command):
    """A verb that takes ROS arguments, which no parser of ours touches.

    Attributes:
        help: returns what --help prints after the usage.
        main: does the work; returns the exit status.
    """

    help: Callable[[], str]
    main: Callable[[Sequence[str]], int]
