"""Speed and error of the one-step fit of the load simulator, against what else could be used.

Run: python -m benchmarks.populations. It prints ratios taken in one run, after checking that
what it compares gives the same errors. The rivals (bees-algorithm, pyswarms) are in the
dependency group `bench`; one that is not installed is reported as absent.
"""
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter
import tracemalloc
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.signal import lfilter

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.one_step import least_squares, Objective, one_step_error
from hydro_twin.fitting.regression import Regression, regression
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.plants.load_simulator_eq1 import coefficients
from hydro_twin.recording.read import read_recording
from hydro_twin.recording.series import Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording
from hydro_twin.studies.b19.populations import METHODS
from hydro_twin.studies.b19.scorer import CYCLES, INDIVIDUALS

NAMES = [p.name for p in LOAD_SIMULATOR.parameters]
LOWER = np.array([p.lower for p in LOAD_SIMULATOR.parameters])
UPPER = np.array([p.upper for p in LOAD_SIMULATOR.parameters])
SIGNALS = 'T_g', ('u_m', 'theta_d'), 4
CANDIDATES = INDIVIDUALS * CYCLES
SEEDS = range(11)


def eq1(parameters: FloatArray) -> FloatArray:
    return coefficients(parameters, {'D_m': 2e-5}, 0.002)


def recording(samples: int, friction: float) -> list[Series]:
    """Sinusoids of 1, 7 and 9 Hz, as in [B19], with friction that the model lacks."""
    rng = np.random.default_rng(0)
    t = 0.002 * np.arange(samples)
    c = eq1(np.sqrt(LOWER * UPPER)[None])[0]
    stretches = []
    for hertz in (1.0, 7.0, 9.0):
        u = 0.3 * np.sin(2 * np.pi * hertz * t) + 0.1 * rng.standard_normal(samples)
        theta = 0.01 * np.sin(2 * np.pi * hertz * t + 1.0)
        drive = np.convolve(u, c[4:9])[:samples] + np.convolve(theta, c[9:])[:samples]
        torque = lfilter([1.0], np.append(1.0, -c[:4]), drive)
        torque += friction * np.sign(np.gradient(theta))
        stretches.append(Series({'T_g': torque, 'u_m': u, 'theta_d': theta}, 0.002))
    return stretches


def over_the_samples(stretches: list[Series], population: FloatArray) -> FloatArray:
    """Evaluate eq. 5 candidate by candidate, each over all samples at once, in plain numpy."""
    errors = []
    for parameters in population:
        c = eq1(parameters[None])[0]
        squares, patterns = 0.0, 0
        for s in stretches:
            n = len(s)
            e = s['T_g'][5:].copy()
            for i in range(4):
                e -= c[i] * s['T_g'][4 - i:n - 1 - i]
            for i in range(5):
                e -= c[4 + i] * s['u_m'][5 - i:n - i]
                e -= c[9 + i] * s['theta_d'][5 - i:n - i]
            squares += e @ e
            patterns += e.size
        errors.append(np.sqrt(squares / patterns))
    return np.array(errors)


def seconds(work: Callable[[], Any], repeats: int = 5) -> float:
    """Time the fastest of some repeats."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return min(times)


def candidates_per_second() -> None:
    population = np.random.default_rng(1).uniform(LOWER, UPPER, (CANDIDATES, 9))
    some = population[:500]
    short, long = recording(1000, friction=5.0), recording(100_000, friction=5.0)
    of_short, of_long = (one_step_error(regression(s, *SIGNALS), eq1) for s in (short, long))
    for objective, stretches in ((of_short, short), (of_long, long)):
        np.testing.assert_allclose(
            objective(some[:20]), over_the_samples(stretches, some[:20]), rtol=1e-8)

    factoring = seconds(lambda: regression(short, *SIGNALS))
    plain = seconds(lambda: over_the_samples(short, some)) * CANDIDATES / len(some)
    turns = [(seconds(lambda: of_short(population), 3), seconds(lambda: of_long(population), 3))
             for _ in range(10)]                                # in turn: the machine is shared
    at_once, at_once_long = np.min(turns, axis=0)
    print(f'{CANDIDATES} candidates on 3 x 995 patterns: {at_once * 1e3:.2f} ms, and the factor '
          f'{factoring * 1e3:.2f} ms once; candidate by candidate in plain numpy '
          f'{plain * 1e3:.0f} ms: {plain / (at_once + factoring):.0f} times faster')
    print(f'cost of a candidate on 3 x 99995 patterns / on 3 x 995: {at_once_long / at_once:.2f}')


def bees_algorithm(objective: Objective, seed: int) -> float:
    from bees_algorithm import BeesAlgorithm
    rival = BeesAlgorithm(
        objective, (LOWER, UPPER),
        {'n_scouts': 20, 'n_sites': 6, 'n_elite_sites': 2, 'n_foragers_site': 10,
         'n_foragers_elite': 20, 'stagnation_limit': 10},
        direction='minimize', vectorized=True, seed=seed)
    return float(rival.optimize(max_iterations=CYCLES - 1).score)


def scipy_evolution(objective: Objective, seed: int) -> float:
    start = np.random.default_rng(seed).uniform(LOWER, UPPER, (INDIVIDUALS, 9))
    return float(differential_evolution(
        lambda x: objective(x.T), list(zip(LOWER, UPPER, strict=True)), init=start,
        maxiter=CYCLES - 1, tol=0.0, polish=False, vectorized=True, updating='deferred',
        rng=seed).fun)


def pyswarms(objective: Objective, seed: int) -> float:
    from pyswarms.single import GlobalBestPSO
    np.random.seed(seed)    # noqa: NPY002 - the only way to seed it
    rival = GlobalBestPSO(INDIVIDUALS, 9, {'c1': 2.0, 'c2': 2.0, 'w': 1.0},
                          bounds=(LOWER, UPPER))
    return float(rival.optimize(objective, CYCLES, verbose=False)[0])


def ours(name: str) -> Callable[[Objective, int], float]:
    return lambda objective, seed: METHODS[name](objective, LOWER, UPPER, seed).error


def against_rivals(friction: float) -> None:
    factor: Regression = regression(recording(1000, friction), *SIGNALS)
    objective = one_step_error(factor, eq1)

    def fit(_: Objective, seed: int) -> float:
        return least_squares(factor, eq1, NAMES, LOAD_SIMULATOR.combinations, LOWER, UPPER,
                             seed).error

    print(f'\n{"linear plant" if friction == 0.0 else "plant with friction"}; no model below '
          f'{factor.rms(factor.best()):.3g}, persistence {factor.persistence():.3g} N m; '
          f'median of {len(SEEDS)} seeds, {CANDIDATES} candidates each:')
    runs = {'least_squares': fit, **{name: ours(name) for name in METHODS},
            'bees-algorithm': bees_algorithm, 'scipy differential_evolution': scipy_evolution,
            'pyswarms': pyswarms}
    errors, times = {}, {}
    for name, run in runs.items():
        try:
            run(objective, 0)
        except ImportError as error:
            print(f'  {name:30} absent: {error}')
            continue
        start = perf_counter()
        errors[name] = median(run(objective, seed) for seed in SEEDS)
        times[name] = (perf_counter() - start) / len(SEEDS)
        print(f'  {name:30} rms {errors[name]:10.4g} N m   {times[name] * 1e3:8.1f} ms')
    for mine, rival in (('bees', 'bees-algorithm'), ('pso', 'pyswarms'),
                        ('ea', 'scipy differential_evolution'),
                        *(('least_squares', rival) for rival in list(runs)[5:])):
        if rival in errors:
            print(f'  {mine} / {rival}: rms {errors[mine] / errors[rival]:.3g}, '
                  f'time {times[mine] / times[rival]:.2g}')


def long_recording(samples: int = 10_000_000, in_bag: int = 200_000) -> None:
    rng = np.random.default_rng(2)
    columns = {name: rng.standard_normal(samples) for name in ('T_g', 'u_m', 'theta_d')}
    series = Series(columns, 0.002)
    tracemalloc.start()
    regression([series], *SIGNALS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    fitting = seconds(lambda: least_squares(
        regression([series], *SIGNALS), eq1, NAMES, LOAD_SIMULATOR.combinations, LOWER, UPPER,
        0), 2)
    with TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        signals = load_signals('load_simulator', list(columns))
        write_recording(bag, [series.part(0, in_bag)], signals)
        reading = seconds(lambda: read_recording([bag], signals, ['u_m'], 0.002), 3)
    print(f'\n{samples:.0e} samples: fit in {fitting:.2f} s, {peak / 2**20:.1f} MiB beside the '
          f'samples; {samples / fitting:.3g} samples/s, {samples / fitting * reading / in_bag:.1f}'
          f' times as fast as a bag of {in_bag} samples is read')


if __name__ == '__main__':
    candidates_per_second()
    against_rivals(friction=5.0)
    against_rivals(friction=0.0)
    long_recording()
