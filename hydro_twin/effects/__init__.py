"""The effects a plant may lack: one file an effect, each found here by being in this folder."""
from __future__ import annotations

import copyreg
import importlib
import pickle
import pkgutil
from typing import Any

from hydro_twin.effects.curve import CURVE, of_kind
from hydro_twin.effects.effect import Effect, EffectParameter, Placed, sites, Span

__all__ = ['EFFECTS', 'Effect', 'EffectParameter', 'Placed', 'Span', 'sites']


def found() -> tuple[tuple[str, Effect], ...]:
    """Import every module of this folder that declares an effect, in the order of their names."""
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__))
    loaded = [(name, importlib.import_module(f'{__name__}.{name}')) for name in modules]
    return tuple((name, module.EFFECT) for name, module in loaded if hasattr(module, 'EFFECT'))


MODULES, EFFECTS = zip(*found(), strict=True)


def _of_module(name: str) -> Effect:
    """Return the effect that a module of this folder declares."""
    effect: Effect = EFFECTS[MODULES.index(name)]
    return effect


def _reduced(effect: Effect) -> tuple[Any, ...] | str:
    """Pickle an effect of this folder, whose law is compiled, by the name of its module."""
    for name, known in zip(MODULES, EFFECTS, strict=True):
        if effect is known:
            return _of_module, (name,)
    if effect.law is CURVE.law:
        return of_kind, (*effect.kinds, *effect.reads, effect.parameters[-1].upper)
    return effect.__reduce_ex__(pickle.HIGHEST_PROTOCOL)


copyreg.pickle(Effect, _reduced)
