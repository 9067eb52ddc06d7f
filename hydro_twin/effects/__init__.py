"""The effects a plant may lack: one file each, found in this folder or by an entry point."""
from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

from hydro_twin.effects.effect import Effect, EffectParameter, Placed, sites, Span
from hydro_twin.errors import ModelError
from hydro_twin.plugins import plugins

__all__ = ['EFFECTS', 'Effect', 'EffectParameter', 'Placed', 'Span', 'sites']

GROUP = 'hydro_twin.effects'    # entry points of other packages, each a module with an `EFFECT`


def _found() -> tuple[tuple[str, Effect], ...]:
    """Import every module that declares an effect: this folder's by name, then those of others.

    Raises:
        ModelError: an entry point is not a module with an effect.
    """
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    modules = [importlib.import_module(f'{__name__}.{name}') for name in names]
    for module in plugins(GROUP):
        if not isinstance(module, ModuleType) or not isinstance(
                getattr(module, 'EFFECT', None), Effect):
            raise ModelError(f'an entry point of {GROUP} is {module!r}, not a module with an '
                             'EFFECT')
        modules.append(module)
    return tuple((module.__name__, module.EFFECT) for module in modules
                 if hasattr(module, 'EFFECT'))


MODULES, EFFECTS = zip(*_found(), strict=True)
