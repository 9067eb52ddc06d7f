"""Compiled functions that apply the law of any effect by its number.

numba compiles calls of functions it knows by name, so the function is written out, with a branch
for each effect found, into the folder of compiled code. Adding an effect is adding its file.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hydro_twin.compiled import compiled, generated
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
    here = [f'law_{k} = inlined_too(law_{k})' for k, _ in laws]
    branches = [f'    if code == {k}:\n        return law_{k}(v, s, p, z, h, c, z_next)'
                for k, _ in laws]
    return '\n'.join([
        'from hydro_twin.compiled import inlined, inlined_too, not_inlined', *imports, '', *here,
        '', '', '@inlined', 'def apply(code, v, s, p, z, h, c, z_next):', *branches,
        '    return v', '', '', '@not_inlined', 'def call(code, v, s, p, z, h, c, z_next):',
        '    return apply(code, v, s, p, z, h, c, z_next)', ''])


_module = generated(NAME, source)
apply: Callable[..., Any] = _module.apply       # stands in what calls it, with all laws
call: Callable[..., Any] = _module.call         # the same as a call


@compiled
def transmit(values, gain, number, parameters, none):  # type: ignore[no-untyped-def]
    """Pass values (N,) in place through a law without memory; `gain` times them reach its port.

    none: zeros (2,), for the signals and the memory that it does not have.
    """
    for k in range(len(values)):
        values[k] = call(number, gain * values[k], none, parameters, none, 0.0, 0.0, none) / gain
