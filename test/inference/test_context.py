"""What was fitted before is used again, where it was fitted as far as is asked."""
from __future__ import annotations

import math
from types import SimpleNamespace

from hydro_twin.inference import context as context_module
from hydro_twin.inference.context import Context


def test_alternatives_are_fitted_again_where_more_or_worse_ones_are_asked_for(monkeypatch):
    fitted = []

    def fit_alternatives(fit, parts, times, most, *, afresh, progress, most_error):
        fitted.append((most, most_error))
        return []

    monkeypatch.setattr(context_module, 'fit_alternatives', fit_alternatives)
    context = Context([], [], (0.0, 1.0), 0, lambda _: None)
    fit = SimpleNamespace(candidate=SimpleNamespace(effects=()), unknowns=())
    for asked in ((4, 2.0), (4, 1.0), (3, 2.0), (4, 3.0), (8, 3.0), (4, 2.0), (4, math.inf)):
        context.fit_alternatives(fit, *asked)
    assert fitted == [(4, 2.0), (4, 3.0), (8, 3.0), (4, math.inf)]
