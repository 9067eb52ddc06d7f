"""The state at which a run starts, as the first samples measured show it."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.system import System

START = 50              # samples at the begin of a part that set its state, and are not scored
MOVES = 0.5             # of the mean square that rest misses: less is left by a start in motion
NEARER = 0.9            # of the mean square missed: more is left by the last step of a search
STEPS = 8               # of that search
HELD = 0.01             # cost of a deviation from rest, over that of as large an output
DAMPED = (HELD, 0.3, 10.0)      # and of one from the last step


@dataclass(frozen=True)
class Start:
    """The state at which a run starts.

    Attributes:
        x: the state, (n,).
        gain: how it follows the first outputs measured, (n, START).
    """

    x: FloatArray
    gain: FloatArray


def find_start(system: System, response: FloatArray, inputs: FloatArray, measured: FloatArray,
               least: float) -> Start:
    """Find the state from which the output is least missed, beginning at rest.

    A search with damped steps [Levenberg 1944], under the whole model. States that the output
    does not tell stay near rest: a deviation costs as if the output were measured to one per cent.

    Args:
        system: the model.
        response: how the output moves with the state, linear laws, (N, n).
        inputs: (N, m).
        measured: the output, (N,).
        least: movement of the output that is worth following, above zero.
    """
    x = system.start(inputs[0], measured[0])
    size = max(rms(measured - measured.mean()), least)
    shown = np.sqrt(np.mean(response**2, axis=0))
    scale = size / np.where(shown > 0.0, shown, 1.0)
    missed = measured - system.run(inputs, x)

    def gain(columns: FloatArray, held: float) -> FloatArray:
        """Return how far an output missed by one moves the state, (n, N)."""
        if not (np.isfinite(columns).all() and np.isfinite(missed).all()):
            return np.zeros(columns.T.shape)
        normal = columns.T @ columns
        ridge = (held * size) ** 2 + 1e-12 * np.trace(normal)
        moved: FloatArray = scale[:, None] * np.linalg.solve(
            normal + max(ridge, 1e-300) * np.eye(len(x)), columns.T)
        return moved

    def step(columns: FloatArray, held: float, enough: float) -> bool:
        """Move the state if that leaves little enough of the mean square; False if not."""
        nonlocal x, missed
        moved = gain(columns, held) @ missed
        foretold = missed - columns @ (moved / scale)
        if not foretold @ foretold < enough * (missed @ missed):
            return False
        left = measured - system.run(inputs, x + moved)
        if not left @ left < enough * (missed @ missed):
            return False
        x, missed = x + moved, left
        return True

    columns = response * scale
    if len(system.table) == 0:
        step(columns, HELD, 1.0)
        return Start(x, gain(columns, HELD))
    # What sticks at rest has no derivative there: first by the linear laws, if it moves.
    step(columns, HELD, MOVES)
    for _ in range(STEPS):
        here = measured - missed
        columns = np.stack([system.run(inputs, x + 0.01 * s * unit) - here
                            for s, unit in zip(scale, np.eye(len(x)), strict=True)], axis=1) / 0.01
        if not any(step(columns, held, NEARER) for held in DAMPED):
            break
    return Start(x, gain(columns, HELD))
