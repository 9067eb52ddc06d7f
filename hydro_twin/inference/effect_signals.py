"""What passes at the port of an effect while a model runs."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed
from hydro_twin.fitting.output_error import initial_states
from hydro_twin.fitting.parts import Part
from hydro_twin.model import Model
from hydro_twin.predictors import kernel


@dataclass(frozen=True)
class EffectSignals:
    """What passes at the port of one effect while a model runs over a part.

    Attributes:
        signals: what the law reads there, the port's own value among it, each (N,).
        added: by the effect to the port's value, (N,).
        left: measured less predicted, (N,).
    """

    signals: dict[str, FloatArray]
    added: FloatArray
    left: FloatArray


def effect_signals(candidate: Model, placed: Placed, part: Part) -> EffectSignals:
    """Run over a part and watch one effect; explicit ones on the same port count together."""
    s = candidate.system
    e, port = s.placed.index(placed), candidate.plant.ports.index(placed.port)
    m = len(s.step.shift)
    start, work = initial_states(candidate, [part]), s.work()
    period = round(1e9 * candidate.sample_time)
    x, z = start.x[0], start.z[0]
    u, d = work[1, :m], work[5, :len(candidate.plant.ports)]
    seen = np.empty((len(part.inputs), len(s.step.H)))
    added, y = np.empty(len(seen)), np.empty(len(seen))
    for k in range(len(seen)):
        stage = s.at(part.start + k * period)
        if k == 0:
            y[k] = kernel.output(stage.step, x, z, work, part.inputs, k, True)
        else:
            y[k] = kernel.advance(stage.step, x, z, work, part.inputs, k, True)
        added[k] = z[len(z) - len(s.step.effects) + e] if placed.effect.implicit else d[port]
        seen[k] = stage.step.H @ np.concatenate([x, u, d])
    rows = {} if placed.effect.implicit else {'value': port}
    effect = s.step.effects[e]
    rows |= dict(zip(placed.effect.reads, (effect['signal_0'], effect['signal_1']),
                     strict=False))
    signals = {name: seen[:, row] for name, row in rows.items()}
    return EffectSignals(signals, added, part.measured - y)
