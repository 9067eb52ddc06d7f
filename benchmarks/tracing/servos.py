"""Random turbine valve servos with known effects, recorded, traced and counted.

python -m benchmarks.tracing.servos -o out/servos.jsonl --count 24
python -m benchmarks.tracing.servos -o out/servos_held_out.jsonl --count 24 --seeds held_out
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from benchmarks.tracing.cases import BLOCK, FIRST_SEED
from benchmarks.tracing.figures import read, report
from benchmarks.tracing.run import add_trace, arguments, complete, seeds_of
from benchmarks.tracing.servo_laws import Around, DRAWS, Fields, integrate, Scales, Servo
from benchmarks.tracing.signals import delayed, FloatArray, Generator, noise, on_steps, play
from hydro_twin.recording.series import Recording, Series

SAMPLE_TIME = 0.002
SUBSTEPS = 40
SERIES = 3
SAMPLES = 3000
NOISE_LEVELS = (46.0, 36.0, 26.0)
EXCITATIONS = ('steps', 'ramps', 'multisine', 'sine')
KINDS = ('none', 'single', 'variant', 'outside')

# [L18]: T_y and T_c as published; the lag and the correction about the published values
BOX = {'T_y': (1e-2, 3e-2), 'T_c': (0.1, 0.5), 'tau': (1e-3, 1e-2), 'k_1': (0.7, 1.5)}


@dataclass(frozen=True)
class Rig:
    """A recording of a servo and what is behind it."""

    series: tuple[dict[str, FloatArray], ...]
    servo: Servo
    around: Around
    fields: Fields
    law: str
    noise_rms: float
    interpolation: str

    def recording(self) -> Recording:
        """Return the series as the product reads them from bags."""
        return Recording(tuple(
            Series(columns, SAMPLE_TIME, start=i * 10_000_000_000, source='servo')
            for i, columns in enumerate(self.series)))


def case_of(seed: int) -> tuple[str, int, str, float]:
    """Return kind, number of the draw, excitation and noise level that a seed stands for."""
    block, index = divmod(seed % FIRST_SEED['held_out'], BLOCK)
    kind = KINDS[block]
    turn, choice = divmod(index, len(DRAWS[kind]))
    mix = turn + choice
    return kind, choice, EXCITATIONS[mix % 4], NOISE_LEVELS[mix % 3]


def make_rig(seed: int) -> Rig:
    """Draw a servo and record it."""
    kind, choice, excitation, snr_db = case_of(seed)
    of_laws, of_drive, of_effects, of_noise = map(
        np.random.default_rng, np.random.SeedSequence(seed).spawn(4))
    linear = Servo(**{name: math.exp(of_laws.uniform(math.log(low), math.log(high)))
                      for name, (low, high) in BOX.items()})
    u = [_command(excitation, of_drive) for _ in range(SERIES)]
    interpolation = 'linear' if of_drive.random() < 0.25 else 'hold'
    y = _openings(linear, Around(), u, interpolation)
    both = np.concatenate(y)
    errors = np.concatenate(u) - both
    scales = Scales(
        u=max(np.max(x) for x in u), span=float(np.ptp(both)), error=float(np.abs(errors).max()),
        speed=float(max(np.abs(np.diff(x)).max() for x in y)) / SAMPLE_TIME,
        top=float(both.max()), duration=SERIES * SAMPLES * SAMPLE_TIME)
    _, law, draw = DRAWS[kind][choice]
    fields = draw(scales, of_effects)
    servo = linear._replace(**{k: v for k, v in fields.items() if k in Servo._fields})
    around = Around(**{k: v for k, v in fields.items() if k in Around._fields})
    clean = _openings(servo, around, u, interpolation)
    size = float(np.std(np.concatenate(clean))) * 10 ** (-snr_db / 20)
    memory = of_noise.uniform(0.3, 0.8) if of_noise.random() < 0.15 else 0.0
    series = tuple({'command': a, 'opening': b + size * noise(len(b), of_noise, memory)}
                   for a, b in zip(u, clean, strict=True))
    return Rig(series, servo, around, fields, law, size, interpolation)


def _command(excitation: str, rng: Generator) -> FloatArray:
    time = SAMPLE_TIME * np.arange(SAMPLES)
    middle, reach = rng.uniform(0.4, 0.6), rng.uniform(0.15, 0.4)
    if excitation in ('steps', 'ramps'):
        edges = np.cumsum(rng.uniform(0.2, 1.5, 60))
        levels = rng.uniform(-1.0, 1.0, 61)
        if excitation == 'steps':
            return middle + reach * levels[np.searchsorted(edges, time)]
        return middle + reach * np.interp(time, np.concatenate(([0.0], edges)), levels)
    if excitation == 'multisine':
        f = rng.uniform(0.1, 4.0, rng.integers(5, 12))
        wave = np.sin(2 * np.pi * np.outer(time, f) + rng.uniform(0, 2 * np.pi, len(f))).sum(1)
        return middle + reach * wave / np.abs(wave).max()
    return middle + reach * np.sin(2 * np.pi * rng.uniform(0.2, 2.0) * time)


def _openings(r: Servo, around: Around, u: list[FloatArray], how: str) -> list[FloatArray]:
    step = SAMPLE_TIME / SUBSTEPS
    found = []
    for i, raw in enumerate(u):
        fine = np.minimum(on_steps(raw, SUBSTEPS, how) + around.command_bias, around.command_limit)
        fine = fine - np.clip(fine - 0.5, -around.command_dead, around.command_dead)
        if around.command_play:
            fine = fine[0] + play(fine - fine[0], around.command_play)
        if around.delay:
            fine = fine[0] + delayed(fine - fine[0], around.delay, step, 'pure')
        start = i * len(raw) * SAMPLE_TIME
        time = start + SAMPLE_TIME * np.arange(len(raw))
        found.append(integrate(r, fine, start, step, SUBSTEPS) + around.sensor_bias
                     + around.line * np.sin(2 * np.pi * around.line_hz * time))
    return found


def shows(rig: Rig) -> float:
    """Return the relative rise of the best linear free run's error above the noise."""
    names = ('T_y', 'T_c', 'tau')

    def error(z: FloatArray) -> FloatArray:
        # k_1 counts only as T_c / k_1; a start that is not at rest is fitted, too
        linear = rig.servo._replace(**Servo(1.0, 1.0, 1.0, 1.0)._asdict() | dict(
            zip(names, np.exp(z[:3]), strict=True)))
        out = []
        for s in rig.series:
            run = _openings(linear, Around(), [s['command']], rig.interpolation)[0]
            free = _decays(linear)
            left = s['opening'] - run
            out.append(left - free @ np.linalg.lstsq(free, left, rcond=1e-10)[0])
        return np.concatenate(out)

    start = np.log([rig.servo.T_y, rig.servo.T_c / rig.servo.k_1, rig.servo.tau])
    best = least_squares(error, start, max_nfev=20, diff_step=1e-4)
    return float(np.sqrt(2 * best.cost / (SERIES * SAMPLES))) / rig.noise_rms - 1.0


def _decays(r: Servo) -> FloatArray:
    poles = np.roots([r.T_c * r.T_y * r.tau, r.T_c * (r.T_y + r.tau), r.T_c, r.k_1])
    n = np.arange(SAMPLES)
    pulse = np.zeros(SAMPLES)
    pulse[0] = 1.0
    whole = np.real(np.poly(np.exp(poles * SAMPLE_TIME)))
    base = lfilter([1.0], whole, pulse)
    return np.stack([np.where(n >= k, np.roll(base, k), 0.0) for k in range(3)], axis=1)


def trace_servo(seed: int) -> dict[str, Any]:
    """Return the truth, what the tracer said ('report' or 'failure') and how long it took."""
    from hydro_twin.plants.valve_servo import VALVE_SERVO

    kind, choice, excitation, snr_db = case_of(seed)
    rig = make_rig(seed)
    effect = DRAWS[kind][choice][0]
    line: dict[str, Any] = {
        'seed': seed, 'kind': kind, 'effects': [effect] if effect else [], 'snr_db': snr_db,
        'excitation': excitation, 'truth': {'noise_rms': rig.noise_rms, 'law': rig.law,
                                            'fields': rig.fields},
        'shows': shows(rig), 'true_error': None,
    }
    add_trace(line, rig.recording(), VALVE_SERVO)
    return line


def main() -> None:
    """Trace the servos that the file lacks, then print the figures of all in it."""
    asked = arguments(__doc__, KINDS, 24)
    complete(asked.output, seeds_of(asked, KINDS), trace_servo, asked.workers)
    print(report(read(asked.output)))


if __name__ == '__main__':
    main()
