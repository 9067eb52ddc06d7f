"""One compiled function that calls the law of any effect by its number.

numba compiles calls of functions it knows by name, so the function is written out, with a branch
for each effect found, into the folder of compiled code. Adding an effect is adding its file.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hydro_twin.compiled import generated
from hydro_twin.effects import curve, Effect, EFFECTS, MODULES

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


apply: Callable[..., Any] = generated(NAME, source).apply
