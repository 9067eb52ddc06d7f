"""What is being done, shown on standard error."""
from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
import sys
from time import monotonic
from typing import Protocol

LOGGED = 30.0           # s between two lines in a log


class Step(Protocol):
    """Is called after each step."""

    def __call__(self, now: str = '', /) -> None:
        """Take note of a step; `now` is what is done next, if that is worth saying."""


# (what is being done, number of steps if known) -> a context that gives what each step calls
Progress = Callable[[str, int | None], AbstractContextManager[Step]]


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Step]:
    """Show on standard error that something takes time: a bar, or lines now and then in a log.

    Args:
        what: is being done.
        total: number of steps; None if that is not known.

    Yields:
        What to call after each step.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _log(what)
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)

        def step(now: str = '', /) -> None:
            bar.update(task, advance=1, description=f'{what}: {now}' if now else what)

        yield step


def _log(what: str) -> Step:
    """Return a step that prints if LOGGED seconds have passed since the last, or the start."""
    begin = last = monotonic()

    def step(now: str = '', /) -> None:
        nonlocal last
        at = monotonic()
        if at - last > LOGGED:
            last = at
            stage = f': {now}' if now else ''
            print(f'{what}, {at - begin:.0f} s{stage}', file=sys.stderr, flush=True)

    return step


@contextmanager
def silent(what: str, total: int | None = None) -> Iterator[Step]:    # noqa: ARG001
    """Show nothing."""
    yield lambda _='', /: None
