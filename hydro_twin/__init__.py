"""A digital twin of electro-hydraulic actuators: live beside the rig, and offline on bags.

    import hydro_twin as ht

    data = ht.read('bags/rig_a', 'load_simulator')
    fit = ht.refit(data)
    trace = ht.trace(data)

The names are those of `hydro_twin.api`, which is imported when the first of them is used.
"""
from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hydro_twin.api import (
        Data,
        excitation,
        load_predictor,
        Model,
        Predictor,
        read,
        read_model,
        Recording,
        Refit,
        refit,
        Replay,
        replay,
        Request,
        Trace,
        trace,
    )

__all__ = ['Data', 'Model', 'Predictor', 'Recording', 'Refit', 'Replay', 'Request', 'Trace',
           'excitation', 'load_predictor', 'read', 'read_model', 'refit', 'replay', 'trace']


def __getattr__(name: str) -> object:
    """Take a name from the interface (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from hydro_twin import api

    return getattr(api, name)


def __dir__() -> list[str]:
    """List the names of the interface."""
    return __all__
