"""What is being done, shown on standard error."""
from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
import sys
from time import monotonic

LOGGED = 30.0           # s between two lines in a log

# (what is being done, number of steps if known) -> a context that gives a function for each step
Progress = Callable[[str, int | None], AbstractContextManager[Callable[[], None]]]


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Callable[[], None]]:
    """Show on standard error that something takes time: a bar, or lines now and then in a log.

    Args:
        what: is being done.
        total: number of steps; None if that is not known.

    Yields:
        A function to call after each step.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _log(what)
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)


def _log(what: str) -> Callable[[], None]:
    """Return what writes a line where the last one, or the begin, is a while ago."""
    begin = last = monotonic()

    def step() -> None:
        nonlocal last
        now = monotonic()
        if now - last > LOGGED:
            last = now
            print(f'{what}, {now - begin:.0f} s', file=sys.stderr, flush=True)

    return step


@contextmanager
def silent(what: str, total: int | None = None) -> Iterator[Callable[[], None]]:    # noqa: ARG001
    """Show nothing."""
    yield lambda: None
