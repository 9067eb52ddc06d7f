"""Compilation of the inner loop, once for each version of the sources, and cached on disk."""
from __future__ import annotations

from collections.abc import Callable
from functools import cache
import hashlib
import importlib.util
import os
from pathlib import Path
import sys
import tempfile
from types import FunctionType, ModuleType
from typing import Any

from llvmlite import binding as llvm
import numba
from numba.core import event

from hydro_twin.files import write_whole
from hydro_twin.plugins import plugin_files

PACKAGE = Path(__file__).parent


def sources() -> list[Path]:
    """List what compiled code depends on: all effects, also of other packages, and predictors."""
    return sorted([*(PACKAGE / 'effects').glob('*.py'), *(PACKAGE / 'predictors').glob('*.py'),
                   *plugin_files('hydro_twin.effects'), Path(__file__)])


def cache_folder() -> Path:
    """Name the folder for compiled code, a new one whenever a source changes.

    numba looks only at the file of the function that is called, not at those of the
    functions that it calls: after an edit of an effect it would run the old one.
    """
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.name.encode() + path.read_bytes())
    try:
        base = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
        folder = base / 'hydro_twin' / digest.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):         # no home, or a read-only one: compile in every run
        folder = Path(tempfile.mkdtemp(prefix='hydro_twin_'))
    return folder


CACHE = cache_folder()


@cache
def _digest(path: Path) -> bytes:
    """Digest a file, once for all functions in it."""
    return hashlib.sha256(path.read_bytes()).digest()


class SameSources:
    """Where numba keeps a compiled function: one place for all copies of the same sources.

    By itself it keeps one for each path: a checkout, a workspace that was built from it and an
    environment into which it was installed would compile anew. With an older numba, which has no
    such setting, they do.
    """

    def __init__(self, path: Path, line: int) -> None:
        self.path, self.line = path, line

    @classmethod
    def from_function(cls, function: Callable[..., Any], path: str) -> SameSources:
        """Take a function of that file."""
        return cls(Path(path), function.__code__.co_firstlineno)

    def ensure_cache_path(self) -> None:
        """Do nothing: the folder is there."""

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(CACHE)

    def get_source_stamp(self) -> bytes:
        """Return what changes with the source."""
        return _digest(self.path)

    def get_disambiguator(self) -> str:
        """Return what tells functions of the same name in files of the same name apart."""
        return f'{self.path.parent.name}-{self.line}'


numba.config.CACHE_DIR = str(CACHE)  # type: ignore[attr-defined]
numba.config.CACHE_LOCATOR_CLASSES = (  # type: ignore[attr-defined]
    f'{SameSources.__module__}.{SameSources.__qualname__}')
# The loops here are too short to vectorise (but see `rows`), and at level 3 LLVM takes half as
# long again to compile what then runs no faster. Nor are they unrolled: the code of a step would
# outgrow the processor's cache, and a run take a fifth longer.
numba.config.LOOP_VECTORIZE = 0  # type: ignore[attr-defined]
numba.config.OPT = type(numba.config.OPT)(2)  # type: ignore[attr-defined]
llvm.set_option('hydro_twin', '-unroll-runtime=false')


class _Notice(event.Listener):
    """Tells a person at a terminal, once, why the first run takes longer."""

    shown = False

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002
        """Speak at the first compilation; what comes from the cache is none."""
        if not self.shown and sys.stderr.isatty():
            print('compiling, once for this version: about 10 s, for fits a minute',
                  file=sys.stderr)
        self.shown = True

    def on_end(self, event: event.Event) -> None:
        """Say nothing more."""


event.register('numba:compile', _Notice())  # type: ignore[no-untyped-call]


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with numba, strictly in IEEE order, so that every caller gets the same digits.

    What is compiled works in arrays that it is given and allocates none. That leaves out numba's
    counting of references, which here would cost five times the arithmetic. A function whose first
    caller is an inlined one is compiled inlined, too.
    """
    return _compiled(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into each of its callers.

    For what a step calls many times: to pass some twenty arrays, which are two hundred numbers,
    would take as long as the work.
    """
    return _compiled(function, forceinline=True)


def inlined_too(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function once more, to be inlined; the cache holds it under a name of its own.

    Args:
        function: compiled, to be called.
    """
    plain = getattr(function, 'py_func', function)      # where numba is switched off, itself
    name = f'{plain.__name__}_inlined'
    copy = FunctionType(plain.__code__, plain.__globals__, name, plain.__defaults__,
                        plain.__closure__)
    copy.__qualname__, copy.__module__ = name, plain.__module__
    return inlined(copy)


def not_inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile once, also where an inlined function calls it: what takes seconds to compile."""
    return _compiled(function, forceinline=False)


def _compiled(function: Callable[..., Any], **more: bool) -> Callable[..., Any]:
    """Compile with the options of all."""
    options: dict[str, Any] = {'cache': True, 'nogil': True, 'error_model': 'numpy',
                               '_nrt': False, **more}
    result: Callable[..., Any] = numba.njit(function, **options)
    return result


def generated(name: str, source: Callable[[], str]) -> ModuleType:
    """Import a module of generated code from the folder of compiled code.

    Args:
        name: of the module.
        source: writes it, where the folder lacks it; it is written atomically.
    """
    path = CACHE / f'{name}.py'
    if not path.exists():
        write_whole(path, source())
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
