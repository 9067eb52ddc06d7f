"""Rigs that are not quite the plant: a valve of second order, or a filter before the card.

python -m benchmarks.tracing.not_quite                       # names and what is built in
python -m benchmarks.tracing.not_quite valve_90 filter_20   # traces these, one JSON line each
"""
from __future__ import annotations

from dataclasses import dataclass, field
import json
import sys
import time
from typing import Any

import numpy as np
from scipy import signal

from benchmarks.tracing import laws, rigs, servo_laws
from benchmarks.tracing.signals import command, FloatArray, on_steps
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series

SAMPLE_TIME, SUBSTEPS = 0.002, 80
FINE = SAMPLE_TIME / SUBSTEPS
SIMULATOR = laws.Laws(V_m=1.75e-4, J=3e-2, K_p=1.2e-2, K_q=0.7, G=1.0e4, K_ce=3e-12, B_m=30.0,
                      K_sv=8e-5, beta_e=7e8)
SERVO = servo_laws.Servo(T_y=0.02, T_c=0.29, tau=0.006, k_1=1.09)
FAST = 5e-5             # [s], what is left of the valve's own lag where another replaces it


@dataclass(frozen=True)
class Case:
    """A rig.

    Attributes:
        valve: natural frequency [Hz] and damping ratio of a valve that replaces the lag.
        lag: time constant of a stage before the valve [s].
        corner: of a first-order filter before the card [Hz].
        ringing: natural frequency [Hz] and damping ratio of the transducer.
        delay: of the command [s].
        laws: what else is built in, as fields of the laws.
    """

    plant: str = 'load_simulator'
    valve: tuple[float, float] | None = None
    lag: float = 0.0
    corner: float = 0.0
    ringing: tuple[float, float] | None = None
    delay: float = 0.0
    laws: dict[str, float] = field(default_factory=dict)
    excitation: str = 'multisine'
    snr_db: float = 46.0
    seed: int = 0


COULOMB = {'coulomb': 6.0, 'static': 6.0}
OVERLAP = {'dead_low': 2e-6, 'dead_high': 2e-6}
CASES = {
    'plain_multisine': Case(seed=1),
    'plain_b19': Case(excitation='b19', seed=2),
    'plain_servo': Case('valve_servo', seed=3),
    'delay_6ms': Case(delay=0.006, seed=4),
    'valve_60': Case(valve=(60.0, 0.7), seed=5),
    'valve_90': Case(valve=(90.0, 0.7), excitation='steps', seed=6),
    'valve_150_b19': Case(valve=(150.0, 0.7), excitation='b19', seed=7),
    'valve_80_friction': Case(valve=(80.0, 0.7), laws=COULOMB, seed=8),
    'valve_60_dead_zone': Case(valve=(60.0, 0.7), laws=OVERLAP, excitation='chirp', seed=9),
    'valve_70_dead_zone': Case(valve=(70.0, 0.7), laws=OVERLAP, seed=20),
    'valve_100_friction_36dB': Case(valve=(100.0, 0.7), laws=COULOMB, snr_db=36.0, seed=21),
    'filter_20': Case(corner=20.0, seed=10),
    'filter_80': Case(corner=80.0, excitation='steps', seed=11),
    'filter_40_friction': Case(corner=40.0, laws=COULOMB, seed=12),
    'filter_30_dead_zone': Case(corner=30.0, laws=OVERLAP, excitation='chirp', seed=13),
    'filter_30_36dB': Case(corner=30.0, snr_db=36.0, seed=14),
    'stage_8ms': Case(lag=0.008, seed=15),
    'ringing_30': Case(ringing=(30.0, 0.1), seed=16),
    'filter_60_friction_steps': Case(corner=60.0, laws=COULOMB, excitation='steps', seed=22),
    'servo_filter_10': Case('valve_servo', corner=10.0, seed=17),
    'servo_filter_5_dead_zone': Case('valve_servo', corner=5.0, laws={'dead': 0.01}, seed=18),
}


def recording(case: Case) -> Recording:
    """Record three series of 1500 samples at 500 Hz."""
    rng = np.random.default_rng(case.seed)
    make = _torques if case.plant == 'load_simulator' else _openings
    columns = make(case, rng)
    output = plant_named(case.plant).output.name
    size = rigs.rms([c[output] - c[output].mean() for c in columns]) * 10 ** (-case.snr_db / 20)
    for c in columns:
        c[output] = c[output] + size * rng.standard_normal(len(c[output]))
    return Recording(tuple(Series(c, SAMPLE_TIME, start=i * 10_000_000_000, source='not_quite')
                           for i, c in enumerate(columns)))


def _torques(case: Case, rng: np.random.Generator) -> list[dict[str, FloatArray]]:
    rig = SIMULATOR._replace(**case.laws)
    if case.valve:
        rig = rig._replace(K_p=FAST)
    t = SAMPLE_TIME * np.arange(rigs.SAMPLES)
    half = 0.5 * FINE * np.arange(2 * SUBSTEPS * len(t) + 1)
    columns = []
    for i in range(rigs.SERIES):
        u = 0.25 * command(case.excitation, i, t, rng) * -np.expm1(-(t / 0.05) ** 2)
        f, phase = rng.uniform(0.5, 3.0), rng.uniform(0, 2 * np.pi)
        angle = 0.01 * (np.sin(2 * np.pi * f * half + phase) - np.sin(phase)) * -np.expm1(
            -(half / 0.1) ** 2)
        fine = _before(case, on_steps(u, SUBSTEPS, 'hold'))
        torque = laws.integrate(rig, fine, angle, 0.0, FINE, 1)[1]
        columns.append({'u_m': u, 'theta_d': angle[::2 * SUBSTEPS][:len(t)],
                        'T_g': _behind(case, torque)[::SUBSTEPS]})
    return columns


def _openings(case: Case, rng: np.random.Generator) -> list[dict[str, FloatArray]]:
    servo = SERVO._replace(**case.laws)
    t = SAMPLE_TIME * np.arange(rigs.SAMPLES)
    columns = []
    for _ in range(rigs.SERIES):
        f, phase = rng.uniform(0.2, 4.0, 8), rng.uniform(0, 2 * np.pi, 8)
        wave = np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1) * -np.expm1(-(t / 0.1)**2)
        u = 0.5 + 0.3 * wave / np.abs(wave).max()
        fine = _before(case, on_steps(u, SUBSTEPS, 'hold'))
        opening = servo_laws.integrate(servo, fine, 0.0, FINE, 1)
        columns.append({'command': u, 'opening': _behind(case, opening)[::SUBSTEPS]})
    return columns


def _before(case: Case, u: FloatArray) -> FloatArray:
    """Pass a command through what is before the valve."""
    if case.delay:
        late = round(case.delay / FINE)
        u = np.concatenate([np.full(late, u[0]), u[:len(u) - late]])
    if case.lag:
        u = _filtered(u, [1.0], [case.lag, 1.0])
    return _second_order(u, *case.valve) if case.valve else u


def _behind(case: Case, y: FloatArray) -> FloatArray:
    """Pass a measurement through what is before the card."""
    if case.corner:
        y = _filtered(y, [1.0], [1.0 / (2 * np.pi * case.corner), 1.0])
    return _second_order(y, *case.ringing) if case.ringing else y


def _second_order(x: FloatArray, frequency: float, damping: float) -> FloatArray:
    w = 2 * np.pi * frequency
    return _filtered(x, [w**2], [1.0, 2 * damping * w, w**2])


def _filtered(x: FloatArray, numerator: list[float], denominator: list[float]) -> FloatArray:
    """Filter from rest, by scipy's bilinear transform at the fine step."""
    b, a = signal.bilinear(numerator, denominator, 1.0 / FINE)
    y: FloatArray = x[0] + signal.lfilter(b, a, x - x[0])
    return y


def trace_case(name: str) -> dict[str, Any]:
    """Trace one, and return what was said, in short."""
    from hydro_twin.inference.trace import trace
    from hydro_twin.report.summary import summarise

    case, begin = CASES[name], time.process_time()
    report = summarise(trace(recording(case), None, plant_named(case.plant)))
    return {
        'name': name, 'verdict': report['verdict'], 'ambiguous': report['ambiguous'],
        'effects': [{'id': e['id'], 'port': e['port'], 'certain': e['certain'],
                     'values': {k: v['value'] for k, v in e['parameters'].items()},
                     'rivals': [[r['id'], round(r['delta_bic'], 1)] for r in e['rivals'][:4]]}
                    for e in report['effects']],
        'free_run': [report[when]['free_run']['test'] for when in ('before', 'after')],
        'noise': report['noise_floor'], 'found': report.get('found'),
        'seconds': time.process_time() - begin}


if __name__ == '__main__':
    for chosen in sys.argv[1:]:
        print(json.dumps(trace_case(chosen)), flush=True)
    if not sys.argv[1:]:
        for label, one in CASES.items():
            print(label, one)
