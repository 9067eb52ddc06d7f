"""What is being done, shown on standard error."""
from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

# (what is being done, number of steps if known) -> a context that gives a function for each step
Progress = Callable[[str, int | None], AbstractContextManager[Callable[[], None]]]


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Callable[[], None]]:
    """Show on standard error that something takes time.

    Args:
        what: is being done.
        total: number of steps; None if that is not known.

    Yields:
        A function to call after each step.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    # Rich ends its display with an empty line, which in a log would stand before an error's one.
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)


@contextmanager
def silent(what: str, total: int | None = None) -> Iterator[Callable[[], None]]:    # noqa: ARG001
    """Show nothing."""
    yield lambda: None
