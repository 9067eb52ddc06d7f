"""Compilation of the inner loop, once for each version of the sources, and cached on disk."""
from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

PACKAGE = Path(__file__).parent


def sources() -> list[Path]:
    """List the files whose code is compiled: the effects and the kernel."""
    return sorted([*(PACKAGE / 'effects').glob('*.py'), *(PACKAGE / 'predictors').glob('*.py'),
                   Path(__file__)])


def cache_folder() -> Path:
    """Name the folder for compiled code, a new one whenever a source changes.

    numba alone looks only at the file of the function that is called, not at those of the
    functions that it calls: after an edit of an effect it would run the old one.
    """
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.read_bytes())
    base = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    folder = base / 'hydro_twin' / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:                         # no home, or a read-only one: compile in every run
        folder = Path(tempfile.mkdtemp(prefix='hydro_twin_'))
    return folder


CACHE = cache_folder()
numba.config.CACHE_DIR = str(CACHE)  # type: ignore[attr-defined]


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with numba, strictly in IEEE order, so that every caller gets the same digits.

    What is compiled works in arrays that it is given and allocates none. That leaves out numba's
    counting of references, which here would cost five times the arithmetic.
    """
    result: Callable[..., Any] = numba.njit(
        function, cache=True, nogil=True, error_model='numpy', _nrt=False)
    return result
