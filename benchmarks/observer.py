"""What a step of the observer costs against one of the free run, and whether it stays sound.

    python -m benchmarks.observer
    python -m benchmarks.observer --soak 10000000

Times are those of the processor, the least of seven turns over 20 000 samples. The soak is a live
run with what goes wrong on a rig: samples without a measurement, alone and in long gaps, outliers,
jumps of the input, and an output that hangs. It fails where a prediction or its deviation is not
finite, where the covariance is no longer positive semidefinite, or where memory grows.
"""
from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
import resource
import time

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.model import Model, Noise, place
from hydro_twin.plants import plant_named
from hydro_twin.predictors.analytical import Analytical

PLANT = plant_named('load_simulator')
NOISE = Noise(0.5, {'x_v': 0.0, 'p_L': 1e4, 'omega_j': 0.05},
              {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1, 'theta_j': 1e-3})
SENSORS = {'p_L': 3e4, 'x_v': 1.5e-7, 'theta_m': 2e-5, 'omega_m': 5e-3}
RIGS = {
    'linear': (),
    'dry friction': (('friction', 'motor', {'coulomb': 8.0}),),
    'dry friction and dead zone': (('friction', 'motor', {'coulomb': 8.0}),
                                   ('dead_zone', 'spool', {'width': 2e-6})),
}
SAMPLES, TURNS, CHUNK = 20_000, 7, 100_000
GROWTH = 8.0            # MiB that the process may grow by in a soak: what lists of figures take


def predictor(rig: str, sensors: Mapping[str, float] | None = None) -> Analytical:
    """Make the predictor of a load simulator with effects, in the middle of its box."""
    values = {**PLANT.constant_values(), **PLANT.middle()}
    effects = tuple(place(*effect, PLANT) for effect in RIGS[rig])
    return Analytical(Model(PLANT, values, PLANT.sample_time, effects,
                            noise=replace(NOISE, sensors=sensors or {})))


def motion(samples: int, rng: np.random.Generator) -> FloatArray:
    """Return a command that wanders and a shaft that swings, (N, 2)."""
    time_ = PLANT.sample_time * np.arange(samples)
    return np.column_stack([np.sin(10.0 * time_) + 0.1 * rng.standard_normal(samples).cumsum()
                            / np.sqrt(samples), 1e-3 * np.sin(7.0 * time_)])


def costs() -> None:
    """Print the time of a step of observer, with four sensors too, and free run, for each rig."""
    rng = np.random.default_rng(1)
    inputs = motion(SAMPLES, rng)
    print('| rig | observer [us] | free run [us] | ratio | observer with four sensors [us] |\n'
          '|---|---|---|---|---|')
    for rig in RIGS:
        model, sensing = predictor(rig), predictor(rig, SENSORS)
        start = np.zeros(len(PLANT.states))
        seen = np.empty((SAMPLES, len(model.system.step.H)))
        measured = (model.system.run(inputs, start, seen=seen)
                    + 0.5 * rng.standard_normal(SAMPLES))
        every = np.column_stack([measured, seen[:, model.system.step.sensors:]
                                 + rng.standard_normal((SAMPLES, len(SENSORS)))
                                 * [*SENSORS.values()]])
        runs = (lambda m=model, y=measured: m.filter.run(inputs, y),
                lambda m=model, x=start: m.system.run(inputs, x),
                lambda m=sensing, y=every: m.filter.run(inputs, y))
        best = [np.inf] * len(runs)
        for _ in range(TURNS):
            for k, run in enumerate(runs):
                begin = time.process_time()
                run()
                best[k] = min(best[k], (time.process_time() - begin) / SAMPLES)
        own, free, sensed = (1e6 * seconds for seconds in best)
        print(f'| {rig} | {own:.2f} | {free:.2f} | {own / free:.1f} | {sensed:.2f} |')


def faulty(measured: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Spoil a measurement as a rig may: lost samples, a gap, outliers, an output that hangs."""
    spoilt = measured.copy()
    n = len(spoilt)
    spoilt[rng.random(n) < 0.01] = np.nan
    begin = rng.integers(0, n - 5000)
    spoilt[begin:begin + 5000] = np.nan
    at = rng.random(n) < 1e-4
    spoilt[at] += rng.choice([-1e6, 1e3, 1e6], np.count_nonzero(at))
    begin = rng.integers(0, n - 2000)
    spoilt[begin:begin + 2000] = spoilt[begin]
    return spoilt


def soak(samples: int) -> None:
    """Step one live observer through so many faulty samples; raise where it is no longer sound."""
    rng = np.random.default_rng(2)
    model = predictor('dry friction and dead zone')
    stepper = model.stepper('observer')
    begin, usual = time.perf_counter(), 0.0
    for done in range(0, samples, CHUNK):
        inputs = motion(CHUNK, rng) + rng.choice([0.0, 5.0])
        measured = faulty(model.system.run(inputs, np.zeros(len(PLANT.states)))
                          + 0.5 * rng.standard_normal(CHUNK), rng)
        for row, value in zip(inputs, measured.tolist(), strict=True):
            if not np.isfinite(stepper.step(row, value)):
                raise AssertionError(f'a prediction is not finite, by sample {done + CHUNK}')
        if not np.isfinite(stepper.estimate).all() or (stepper.estimate[1] < 0.0).any():
            raise AssertionError(f'a deviation is not sound, by sample {done + CHUNK}')
        root = stepper.observation.scratch.S[:, :len(stepper.observation.scratch.S)]
        least = np.linalg.eigvalsh(root @ root.T / np.trace(root @ root.T))[0]
        if least < -1e-12:
            raise AssertionError(f'the covariance is not positive, by sample {done + CHUNK}')
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        usual = usual or grown
        if grown > usual + GROWTH:
            raise AssertionError(f'memory grew by {grown - usual:.1f} MiB')
    seconds = time.perf_counter() - begin
    print(f'{samples} samples, {samples * PLANT.sample_time / seconds:.0f} times as fast as real '
          f'time; every prediction and deviation finite, covariance positive semidefinite, '
          f'{grown - usual:.1f} MiB more at the end than after the first {CHUNK}')


def main() -> None:
    """Print the costs, or soak."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--soak', type=int, metavar='SAMPLES')
    samples = parser.parse_args().soak
    costs() if samples is None else soak(samples)


if __name__ == '__main__':
    main()
