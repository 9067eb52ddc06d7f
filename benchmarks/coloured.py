"""Fits to coloured noise: by its likelihood, against least squares of the same recording.

    uv run python -m benchmarks.coloured

Each draw is two series of 3 s of a load simulator in the middle of its box, at a signal-to-noise
ratio of 36 dB; the noise is autoregressive of first order. The same draw is fitted both ways.
"""
from __future__ import annotations

import argparse
from collections.abc import Mapping

import numpy as np

from benchmarks.tracing.signals import command, noise
from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.coloured import with_coloured_noise
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import Part
from hydro_twin.model import Model
from hydro_twin.plants import plant_named
from hydro_twin.predictors.scores import rms

PLANT = plant_named('load_simulator')
TRUE = PLANT.constant_values() | PLANT.middle()
SAMPLES, SERIES = 1500, 2
AMPLITUDE = 0.3         # of the command [V]
SNR = 36.0              # [dB]
MEMORIES = (0.0, 0.5, 0.9)      # autocorrelation of the noise from one sample to the next
EXCITATIONS = ('steps', 'multisine', 'chirp')
SHOWN = ('K_p', 'K_ce', 'B_m', 'K_q*K_sv')      # what such recordings determine well


def recorded(excitation: str, memory: float, seed: int) -> list[Part]:
    """Record the rig."""
    rng, T = np.random.default_rng(seed), PLANT.sample_time
    t = T * np.arange(SAMPLES)
    system, parts = Model(PLANT, TRUE, T).system, []
    for k in range(SERIES):
        inputs = np.column_stack([AMPLITUDE * command(excitation, k, t, rng),
                                  0.02 * np.sin(2.0 * np.pi * 1.3 * t)])
        y = system.run(inputs, system.start(inputs[0], 0.0))
        y += 10.0**(-SNR / 20.0) * rms(y - y.mean()) * noise(SAMPLES, rng, memory)
        parts.append(Part(inputs, y, start=k * 10_000_000_000))
    return parts


def relative(values: Mapping[str, float]) -> dict[str, float]:
    """Return the error of each parameter or product shown, as a logarithm."""
    return {shown: sum(np.log(values[name] / TRUE[name]) for name in shown.split('*'))
            for shown in SHOWN}


def judged(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Return the errors of what is shown, and their standard errors."""
    known = fit.identifiability()
    said = {**known.std_error, **known.combinations}
    error = relative(fit.candidate.values)
    return (np.array([error[name] for name in SHOWN]),
            np.array([np.nan if said[name] is None else said[name] for name in SHOWN], float))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--draws', type=int, default=80)
    draws = parser.parse_args().draws
    print('| excitation, memory | fitted as coloured | '
          + ' | '.join(f'{name} [%]' for name in SHOWN) + ' | within two standard errors |')
    print('|---' * (len(SHOWN) + 3) + '|')
    for excitation in EXCITATIONS:
        for memory in MEMORIES:
            pairs = []
            for seed in range(draws):
                parts = recorded(excitation, memory, seed)
                fit = fit_linear(PLANT, parts, PLANT.constant_values(), PLANT.sample_time)
                pairs.append((fit, with_coloured_noise(fit, parts)))
            coloured = sum(one is not other for one, other in pairs)
            error, said = (np.array(some) for some in zip(*(
                zip(*map(judged, pair), strict=True) for pair in pairs), strict=True))
            size = 100.0 * np.sqrt(np.mean(error**2, axis=0))
            within = np.mean(np.abs(error) < 2.0 * said, axis=(0, 2))
            print(f'| {excitation}, {memory:g} | {coloured} of {draws} | '
                  + ' | '.join(f'{a:.2f} -> {b:.2f}' for a, b in size.T)
                  + f' | {within[0]:.0%} -> {within[1]:.0%} |', flush=True)


if __name__ == '__main__':
    main()
