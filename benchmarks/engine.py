"""The derivatives of a run and the search with them, against differences on the same kernel.

    python benchmarks/engine.py

The load simulator (4 states) with dry friction, 10 unknowns, 5000 samples. Times are those of the
processor, on one core, best of three; that of compilation is given by itself. scipy's
least_squares takes forward differences of the same compiled run; its unknowns are the same, and
the state at the start with them. At last the search with as many threads of BLAS as there are
cores: run it without OPENBLAS_NUM_THREADS.
"""
from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_info

from hydro_twin.arrays import FloatArray
from hydro_twin.blas import one_thread
from hydro_twin.effects import Placed
from hydro_twin.fitting.output_error import initial_states
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import effect_unknowns, get, plant_unknowns, timing_unknowns
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.predictors.sensitivities import run_with_sensitivities
from hydro_twin.predictors.tangents import tangent_of

PLANT = plant_named('load_simulator')
SAMPLES = 5000


def timed(work: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """Return the least time of the processor [s], and the last result."""
    best, result = np.inf, None
    for _ in range(repeats):
        begin = time.process_time()
        result = work()
        best = min(best, time.process_time() - begin)
    return best, result


def friction(coulomb: float, bias: float) -> tuple[Placed, ...]:
    """Put friction and a bias on the motor."""
    return (place('friction', 'motor', {'coulomb': coulomb}, PLANT),
            place('bias', 'motor', {'offset': bias}, PLANT))


def problem() -> Problem:
    """Make the fit: a recording of known laws with noise, begun from other values."""
    rng = np.random.default_rng(0)
    t = PLANT.sample_time * np.arange(SAMPLES)
    inputs = np.column_stack([
        0.03 * sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.7, 1.9, 4.3, 9.1)),
        0.02 * np.sin(2 * np.pi * 1.3 * t)])
    values = PLANT.constant_values() | {p.name: (p.lower * p.upper) ** 0.5
                                        for p in PLANT.parameters}
    made = Model(PLANT, values, PLANT.sample_time, friction(10.0, 2.0), substeps=2)
    clean = made.system.run(inputs, np.zeros(PLANT.order))
    part = Part(inputs, clean + 0.5 * rng.standard_normal(SAMPLES))
    begun = Model(PLANT, values | {p.name: values[p.name] * rng.uniform(0.8, 1.25)
                                   for p in PLANT.parameters}, PLANT.sample_time,
                  friction(7.0, 1.0), {'u_m': -0.2 * PLANT.sample_time}, substeps=2)
    unknowns = plant_unknowns(PLANT, 'physical') + timing_unknowns(begun)
    for index, placed in enumerate(begun.effects):
        unknowns += effect_unknowns(index, placed)
    return Problem(begun, unknowns, [part])


def by_scipy(fit: Problem) -> Any:
    """Search the same unknowns, and the state at the start, by differences."""
    part, = fit.parts
    begin = np.array([u.coordinate(get(fit.base, u)) for u in fit.unknowns])
    start = initial_states(fit.base, fit.parts)
    scale = np.array([1e-4, 1e6, 0.1, 0.01])
    lower, upper = fit.bounds()

    def residual(x: FloatArray) -> FloatArray:
        y = fit.candidate(x[:len(begin)]).system.run(
            part.inputs, x[len(begin):] * scale, start.z[0])
        return np.concatenate([np.nan_to_num(part.measured - y, nan=1e3),
                               fit.penalty(x[:len(begin)])])

    far = np.full(len(scale), np.inf)
    inside = np.clip(begin, lower + 1e-9, upper - 1e-9)
    return least_squares(residual, np.concatenate([inside, start.x[0] / scale]), max_nfev=40,
                         bounds=(np.append(lower, -far), np.append(upper, far)), ftol=1e-6)


def evaluations(fit: Problem) -> int:
    """Count the evaluations of a search, each with its derivatives."""
    with patch.object(fit, 'at', wraps=fit.at) as at:
        fit.search(40, 1e-6)
    return at.call_count


def main() -> None:
    """Print the figures."""
    fit = problem()
    with one_thread():
        own = alone(fit)
    threads = {pool['num_threads'] for pool in threadpool_info() if pool['user_api'] == 'blas'}
    other, _ = timed(lambda: fit.search(40, 1e-6), 1)
    print(f'with {max(threads)} threads of BLAS {other:.2f} s, {other / own:.1f} times as long')


def alone(fit: Problem) -> float:
    """Print the figures of one core; returns the time of the search [s]."""
    part, = fit.parts
    system = fit.base.system
    x, z = np.zeros(PLANT.order), np.zeros(system.memory)
    compiling, _ = timed(lambda: system.run(part.inputs, x, z), 1)
    by, _ = fit.directions(fit.base)
    tangents = [tangent_of(system, by)]

    edges = np.array([0, len(part.inputs)])

    def with_slopes() -> tuple[FloatArray, FloatArray]:
        return run_with_sensitivities(system, by, tangents, part.inputs, edges, x[None], z[None])

    more, _ = timed(with_slopes, 1)
    print(f'first call: {compiling:.1f} s for the run, {more:.1f} s more for its derivatives '
          '(compiled, or read from the cache)')
    plain, _ = timed(lambda: system.run(part.inputs, x, z), 20)
    slopes, (_, columns) = timed(with_slopes, 20)
    width = np.count_nonzero(np.any(columns[:, 0], axis=0))
    print(f'a run {1e3 * plain:.1f} ms; with {width} columns of derivatives {1e3 * slopes:.1f} '
          f'ms, {slopes / plain:.1f} runs; differences take {width + 1}')
    own, found = timed(lambda: fit.search(40, 1e-6))
    other, there = timed(lambda: by_scipy(fit), 1)
    start_up = fit.base.start_up
    error = np.sqrt(np.mean(there.fun[start_up:SAMPLES] ** 2))
    print(f'{len(fit.unknowns)} unknowns and the state at the start, {SAMPLES} samples: '
          f'{own:.2f} s to an error of {np.sqrt(np.mean(found.residual ** 2)):.4f} '
          f'({found.reason}, {evaluations(fit)} evaluations); scipy with differences '
          f'{other:.2f} s to {error:.4f}, {there.nfev} steps: {other / own:.1f} times as long')
    return own


if __name__ == '__main__':
    main()
