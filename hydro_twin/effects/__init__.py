"""The effects a plant may lack: one file each, found in this folder or by an entry point."""
from __future__ import annotations

import copyreg
import importlib
import pickle
import pkgutil
from types import ModuleType
from typing import Any

from hydro_twin.effects.curve import CURVE, of_kind
from hydro_twin.effects.effect import Course, Effect, EffectParameter, Placed, sites, Span
from hydro_twin.errors import ModelError
from hydro_twin.plugins import plugins

__all__ = ['EFFECTS', 'Course', 'Effect', 'EffectParameter', 'Placed', 'Span', 'sites']

GROUP = 'hydro_twin.effects'    # entry points of other packages, each a module with an `EFFECT`


def _found() -> tuple[tuple[str, Effect], ...]:
    """Import every module that declares an effect: this folder's by name, then those of others.

    Raises:
        ModelError: an entry point is not a module with an effect.
    """
    names = sorted(module.name for module in pkgutil.iter_modules(__path__)
                   if module.name != 'dispatch')    # which is made of all that is found here
    modules = [importlib.import_module(f'{__name__}.{name}') for name in names]
    for module in plugins(GROUP, ModuleType):
        if not isinstance(getattr(module, 'EFFECT', None), Effect):
            raise ModelError(f'an entry point of {GROUP} is {module!r}, not a module with an '
                             'EFFECT')
        modules.append(module)
    return tuple((module.__name__, module.EFFECT) for module in modules
                 if hasattr(module, 'EFFECT'))


MODULES, EFFECTS = zip(*_found(), strict=True)


def _of_module(name: str) -> Effect:
    """Return the effect that a module declares."""
    effect: Effect = EFFECTS[MODULES.index(name)]
    return effect


def _reduced(effect: Effect) -> tuple[Any, ...] | str:
    """Pickle an effect, whose law is compiled, by the name of its module."""
    for name, known in zip(MODULES, EFFECTS, strict=True):
        if effect is known:
            return _of_module, (name,)
    if effect.law is CURVE.law:
        return of_kind, (*effect.kinds, *effect.reads, effect.parameters[-1].upper)
    return effect.__reduce_ex__(pickle.HIGHEST_PROTOCOL)


copyreg.pickle(Effect, _reduced)
