"""A search that holds the runs near what was measured, less and less, until they are free.

Where a mass sticks, the error of a free run has many minima: whether it breaks away at the end of
a slow rise, and when, turns on the last percent of a parameter, and all that follows depends on
it. An observer is set right again by the next samples. So the search begins with output feedback,
which is then withdrawn [Vyasarayani et al. 2012, J. Comput. Nonlinear Dyn. 7, 011012].
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm, LinAlgError, solve_discrete_are

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.noise import reach_of_noise
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.model import Model
from hydro_twin.predictors.observer import process_root

# Of process noise on each state, by how much it moves the output over the start-up time, over the
# noise of measurement. With ten times as much the observer explains what the laws should; with a
# third of the last it hardly differs from a free run.
RATIOS = (3.0, 1.0, 0.3)
TRACKING = 10           # evaluations of a search with feedback: more led no nearer
PASSES = 3              # at most, each from the last
LOWERED = 0.9           # of the RMS residual: a pass that leaves more is the last


def search_by_homotopy(fit: Fit, parts: Sequence[Part], evaluations: int, tolerance: float) -> Fit:
    """Search again from a fit, see above, as often as it pays; the best fit.

    Args:
        fit: where to begin.
        parts: what was fitted.
        evaluations: most of a search of free runs, see `Problem.search`.
        tolerance: of each search, likewise.
    """
    for _ in range(PASSES):
        candidate = fit.candidate
        for ratio in RATIOS:
            gain = steady_state_gain(candidate, ratio)
            if gain is None:
                return fit
            problem = Problem(candidate, fit.unknowns, parts, gain)
            candidate = problem.candidate(problem.search(TRACKING, tolerance).coordinates)
        found = Problem(candidate, fit.unknowns, parts).solve(evaluations, tolerance)
        pays = found.cost < LOWERED * fit.cost
        fit = min(found, fit, key=lambda one: one.cost)
        if not pays:
            break
    return fit


def steady_state_gain(model: Model, ratio: float) -> FloatArray | None:
    """Return the gain of the Kalman filter of the linear laws, (n,), as `OutputFeedback` has it.

    Args:
        model: whose laws.
        ratio: of the process noise, see `RATIOS`.

    Returns:
        The gain; None where there is none, as where the output does not show every state.
    """
    laws, T = model.system.laws, model.sample_time
    reach = reach_of_noise(model)
    root = process_root(laws, T, np.array([
        ratio / reach[name] if reach.get(name) else 0.0 for name in model.plant.states]))
    try:
        covariance = solve_discrete_are(expm(laws.A * T).T, laws.C.T, root @ root.T, np.eye(1))
    except LinAlgError:
        return None
    spread = covariance @ laws.C[0]
    gain: FloatArray = spread / (1.0 + laws.C[0] @ spread)
    return gain
