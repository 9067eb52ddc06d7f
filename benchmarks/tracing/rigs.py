"""Random load simulators and the recordings made on them, each reproducible from its seed."""
from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.tracing.draws import Built, Command, Scales, Sensor
from benchmarks.tracing.lacking import draw
from benchmarks.tracing.laws import integrate, Laws, SAMPLE_TIME, SUBSTEPS
from benchmarks.tracing.signals import (
    command,
    FloatArray,
    Generator,
    Motion,
    noise,
    on_steps,
    shaft_motion,
)
from hydro_twin.recording.series import Recording, Series

LARGEST_TORQUE = 150.0
SERIES = 3
SAMPLES = 1500
WARM_UP = 250

# [B19] Table 1; D_m is not drawn: it is a constant of the rig
BOX = {
    'V_m': (1.6e-4, 1.9e-4), 'J': (1e-2, 1e-1), 'K_p': (5e-3, 3e-2), 'K_q': (0.2, 2.5),
    'G': (7e3, 1.5e4), 'K_ce': (1e-12, 1e-11), 'B_m': (10.0, 100.0), 'K_sv': (3e-5, 2e-4),
    'beta_e': (6.5e8, 7.5e8),
}


@dataclass(frozen=True)
class Truth:
    """What is hidden from a tracer.

    Attributes:
        kind: one of KINDS in cases.py.
        laws, command, sensor: the rig itself, every field of it.
        built: the effects built in.
        excitation: one of EXCITATIONS.
        interpolation: of the command between samples, 'hold' or 'linear'.
        running: the recording starts while the rig moves; else at rest.
        noise: 'white', 'coloured', 'quantised' or 'angle' (white, and theta_d is noisy too).
        noise_rms: of the noise on T_g as drawn [N m].
        effect_rms: how far the effects move T_g from the linear rig's [N m].
    """

    kind: str
    laws: Laws
    command: Command
    sensor: Sensor
    built: tuple[Built, ...]
    excitation: str
    interpolation: str
    running: bool
    noise: str
    noise_rms: float
    effect_rms: float

    def summary(self) -> dict[str, Any]:
        """Return what identifies the rig, for a results file."""
        return {
            'kind': self.kind, 'excitation': self.excitation,
            'interpolation': self.interpolation, 'running': self.running, 'noise': self.noise,
            'noise_rms': self.noise_rms, 'effect_rms': self.effect_rms,
            'effects': [{'id': b.id, 'law': b.law, 'fields': b.fields} for b in self.built],
        }


@dataclass(frozen=True)
class Rig:
    """A recording and the truth behind it.

    Attributes:
        seed: the seed that it was drawn with.
        series: u_m [V], theta_d [rad] and T_g [N m] as measured, for each series.
        clean: T_g without noise, for each series [N m].
        truth: what is behind it.
    """

    seed: int
    series: tuple[dict[str, FloatArray], ...]
    clean: tuple[FloatArray, ...]
    truth: Truth = field(repr=False)

    def recording(self) -> Recording:
        """Return the series as the product reads them from bags."""
        return Recording(tuple(
            Series(columns, SAMPLE_TIME, source=f'rig_{self.seed}',
                   start=round(1e9 * i * len(columns['u_m']) * SAMPLE_TIME))
            for i, columns in enumerate(self.series)))


@dataclass(frozen=True)
class _Drive:
    """Commands at every sample and the motion of the shaft, a pair for each series."""

    u: tuple[FloatArray, ...]
    motion: tuple[Motion, ...]
    gain: tuple[tuple[float, float], ...]   # of both, for each series
    interpolation: str

    def torques(self, laws: Laws, then: Command, substeps: int) -> list[tuple[FloatArray, ...]]:
        """Integrate every series: states, torque, the command and angle as sampled."""
        step = SAMPLE_TIME / substeps
        found = []
        for i, (u, motion, (ku, ka)) in enumerate(
                zip(self.u, self.motion, self.gain, strict=True)):
            fine = then.on(on_steps(ku * u, substeps, self.interpolation), step)
            angle = ka * motion(0.5 * step * np.arange(2 * len(fine) + 1))
            states, torque = integrate(laws, fine, angle, i * len(u) * SAMPLE_TIME, step, substeps)
            found.append((states, torque, ku * u, angle[::2 * substeps][:len(u)]))
        return found

    def scaled(self, gain: Sequence[tuple[float, float]]) -> _Drive:
        """Return the drive with other gains."""
        return _Drive(self.u, self.motion, tuple(gain), self.interpolation)


def make_rig(
    seed: int,
    kind: str = 'single',
    effects: Sequence[str] = (),
    excitation: str = 'b19',
    snr_db: float = 46.0,
    left_out: Collection[str] = (),
) -> Rig:
    """Draw a rig and record it.

    The parameters, the drive and the effects' strengths follow from the seed, so that the
    same seed at another noise level is the same rig.

    Args:
        seed: the seed.
        kind: one of KINDS in cases.py.
        effects: ids, of EFFECTS, VARIED, OUTSIDE or STATIC in lacking.py by the kind; two for
            'pair', three for 'triple'.
        excitation: one of EXCITATIONS.
        snr_db: rms of T_g over rms of its noise [dB].
        left_out: effects drawn like the others, but not built in.
    """
    streams = np.random.SeedSequence(seed).spawn(4)
    of_laws, of_drive, of_effects, of_noise = map(np.random.default_rng, streams)
    linear = Laws(**{
        name: float(np.exp(of_laws.uniform(np.log(low), np.log(high))))
        for name, (low, high) in BOX.items()})
    drive, running = _draw_drive(linear, excitation, of_drive)
    drawn_from = {'pair': 'single', 'triple': 'single', 'static': 'outside'}.get(kind, kind)
    scales = _scales(drive.torques(linear, Command(), 20), linear)
    drawn = [draw(drawn_from, effect, scales, of_effects) for effect in effects]
    built = tuple(b for b in drawn if b.id not in left_out)
    laws, then, sensor = (_with(part, built) for part in (linear, Command(), Sensor()))
    drive = _within_limit(drive, laws, then)
    found = drive.torques(laws, then, SUBSTEPS)
    cut = WARM_UP if running else 0
    clean = [_sensed(torque, sensor, i, of_noise)[cut:] for i, (_, torque, _, _) in
             enumerate(found)]
    without = [torque[cut:] for _, torque, _, _ in drive.torques(linear, Command(), SUBSTEPS)]
    noise_kind, disturbances = _draw_noise(clean, snr_db, of_noise)
    series = []
    for (_, _, u, angle), torque, error in zip(found, clean, disturbances, strict=True):
        angle = angle[cut:]
        if noise_kind == 'angle':
            angle = angle + 2e-6 * of_noise.standard_normal(len(angle))
        series.append({'u_m': u[cut:], 'theta_d': angle, 'T_g': torque + error})
    truth = Truth(
        kind, laws, then, sensor, built, excitation, drive.interpolation, running, noise_kind,
        rms(disturbances), rms([a - b for a, b in zip(clean, without, strict=True)]))
    return Rig(seed, tuple(series), tuple(clean), truth)


def rms(parts: Sequence[FloatArray]) -> float:
    """Return the root mean square over all series."""
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _draw_drive(linear: Laws, excitation: str, rng: Generator) -> tuple[_Drive, bool]:
    running = bool(rng.random() < 0.25)
    time = SAMPLE_TIME * np.arange(SAMPLES + WARM_UP * running)
    interpolation = 'linear' if rng.random() < 0.25 else 'hold'
    u = tuple(command(excitation, i, time, rng) for i in range(SERIES))
    motion = tuple(shaft_motion(rng) for _ in range(SERIES))
    unit = _Drive(u, motion, ((1.0, 0.0),) * SERIES, interpolation)
    by_command = [np.abs(f[1]).max() for f in unit.torques(linear, Command(), 20)]
    unit = unit.scaled([(0.0, 1.0)] * SERIES)
    by_shaft = [np.abs(f[1]).max() for f in unit.torques(linear, Command(), 20)]
    gain = []
    for of_u, of_angle in zip(by_command, by_shaft, strict=True):
        target = rng.uniform(50.0, 0.95 * LARGEST_TORQUE)
        shaft = min(1.0, target * rng.uniform(0.1, 0.5) / max(of_angle, 1e-12))
        gain.append(((target - shaft * of_angle) / of_u, shaft))
    return unit.scaled(gain), running


def _scales(found: list[tuple[FloatArray, ...]], laws: Laws) -> Scales:
    states = np.concatenate([f[0] for f in found])
    u = np.concatenate([f[2] for f in found])
    x_rate = (laws.K_sv * u - states[:, 0]) / laws.K_p
    largest = np.abs(states).max(axis=0)
    return Scales(
        u=float(np.abs(u).max()), x=float(largest[0]), x_rate=float(np.abs(x_rate).max()),
        p=float(largest[1]), omega=float(largest[2]), span=float(np.ptp(states[:, 3])),
        torque=float(max(np.abs(f[1]).max() for f in found)), duration=len(u) * SAMPLE_TIME)


def _with[T: (Laws, Command, Sensor)](part: T, built: tuple[Built, ...]) -> T:
    fields = {name: value for b in built for name, value in b.fields.items()
              if name in part._fields}
    return part._replace(**fields)


def _within_limit(drive: _Drive, laws: Laws, then: Command) -> _Drive:
    """Turn the drive down where an effect raises the torque above what the rig bears."""
    for _ in range(4):
        peaks = [np.abs(f[1]).max() for f in drive.torques(laws, then, 40)]
        if max(peaks) <= LARGEST_TORQUE:
            break
        turn = [min(1.0, 0.9 * LARGEST_TORQUE / peak) for peak in peaks]
        drive = drive.scaled([(k * ku, k * ka) for k, (ku, ka) in
                              zip(turn, drive.gain, strict=True)])
    return drive


def _sensed(torque: FloatArray, sensor: Sensor, index: int, rng: Generator) -> FloatArray:
    time = SAMPLE_TIME * (np.arange(len(torque)) + index * len(torque))
    sensed = torque + sensor.sensor_bias + sensor.line * np.sin(2 * np.pi * sensor.line_hz * time)
    if sensor.disturbance:
        sensed += sensor.disturbance * noise(len(torque), rng, sensor.disturbance_memory)
    if sensor.burst:
        begin = time[0] + rng.uniform(0.4, 0.8) * (time[-1] - time[0])
        window = np.exp(-((time - begin) / 0.05) ** 2)
        sensed += sensor.burst * window * np.sin(2 * np.pi * sensor.burst_hz * time)
    return sensed


def _draw_noise(
    clean: list[FloatArray], snr_db: float, rng: Generator,
) -> tuple[str, list[FloatArray]]:
    kind = str(rng.choice(('white', 'coloured', 'quantised', 'angle'), p=(0.7, 0.1, 0.1, 0.1)))
    memory = rng.uniform(0.3, 0.8) if kind == 'coloured' else 0.0
    size = rms(clean) * 10 ** (-snr_db / 20)
    errors = [size * noise(len(torque), rng, memory) for torque in clean]
    if kind == 'quantised':
        errors = [np.round((t + e) / size) * size - t for t, e in zip(clean, errors, strict=True)]
    return kind, errors
