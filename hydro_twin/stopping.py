"""The request to end a node's process (SIGINT, SIGTERM), remembered from before the slow imports.

The exception that Python raises on SIGINT can be lost: where a signal falls into a callback of the
interpreter, as imports have them, the exception is printed and ignored. In a callback of the
EventsExecutor it would abort the process. So a signal is only remembered, and the node looks.
"""
from __future__ import annotations

import signal

_requests: list[int] = []


def listen() -> None:
    """Remember signals from now on, instead of ending by them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: _requests.append(received))


def requested() -> bool:
    """Whether this process has been asked to end since it listened."""
    return bool(_requests)
