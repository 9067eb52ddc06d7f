"""The effects a plant may lack: one file an effect, each found here by being in this folder."""
from __future__ import annotations

import importlib
import pkgutil

from hydro_twin.effects.effect import Effect, EffectParameter, Placed, sites, Span

__all__ = ['EFFECTS', 'Effect', 'EffectParameter', 'Placed', 'Span', 'sites']


def found() -> tuple[tuple[str, Effect], ...]:
    """Import every module of this folder that declares an effect, in the order of their names."""
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__))
    loaded = [(name, importlib.import_module(f'{__name__}.{name}')) for name in modules]
    return tuple((name, module.EFFECT) for name, module in loaded if hasattr(module, 'EFFECT'))


MODULES, EFFECTS = zip(*found(), strict=True)
