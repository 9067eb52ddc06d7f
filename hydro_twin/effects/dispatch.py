"""One compiled function that calls the law of any effect by its number.

numba compiles calls of functions it knows by name, so the function is written out, with a branch
for each effect found, into the folder of compiled code. Adding an effect is adding its file.
"""
from __future__ import annotations

from collections.abc import Callable
import importlib.util
import sys
from typing import Any

from hydro_twin.compiled import CACHE
from hydro_twin.effects import curve, Effect, EFFECTS, MODULES
from hydro_twin.files import write_whole

NAME = 'hydro_twin_dispatch'
LAWS = [(name, effect.law) for name, effect in
        zip((*MODULES, curve.__name__), (*EFFECTS, curve.CURVE), strict=True)]


def code(effect: Effect) -> int:
    """Return the number by which the kernel knows the law of an effect."""
    return [law for _, law in LAWS].index(effect.law)


def source() -> str:
    """Write the module."""
    laws = [(k, name) for k, (name, law) in enumerate(LAWS) if law is not None]
    imports = [f'from {name} import law as law_{k}' for k, name in laws]
    branches = [f'    if code == {k}:\n        return law_{k}(v, s, p, z, h, c, z_next)'
                for k, _ in laws]
    return '\n'.join([
        'from hydro_twin.compiled import compiled', *imports, '', '', '@compiled',
        'def apply(code, v, s, p, z, h, c, z_next):', *branches, '    return v', ''])


def load() -> Callable[..., Any]:
    """Write the module where it is missing, whole or not at all, and import it."""
    path = CACHE / f'{NAME}.py'
    if not path.exists():
        write_whole(path, source())
    spec = importlib.util.spec_from_file_location(NAME, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = module
    spec.loader.exec_module(module)
    function: Callable[..., Any] = module.apply
    return function


apply = load()
