"""Starts a verb with limited resources: `python -m hydro_twin.keep.confined SPEC VERB ...`.

SPEC is a JSON object with nice, memory [bytes] and cores. The limits are set in this process,
which then becomes the verb: so they need no code between fork and exec of a process with threads.
"""
from __future__ import annotations

import contextlib
import ctypes
import json
import os
import resource
import signal
import sys
from typing import NoReturn

PR_SET_PDEATHSIG = 1


def main(spec: str, *arguments: str) -> NoReturn:
    """Set the limits, then become the verb."""
    limits = json.loads(spec)
    with contextlib.suppress(OSError, AttributeError):    # of Linux: die with the node
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    os.nice(max(int(limits['nice']) - os.nice(0), 0))
    if limits.get('cores'):
        os.sched_setaffinity(0, limits['cores'])
    most = int(limits['memory'])
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    os.execv(sys.executable, [sys.executable, '-m', 'hydro_twin.commands.main', *arguments])


if __name__ == '__main__':
    main(*sys.argv[1:])
