"""How often the live twin names the port at which a fault enters, on simulated rigs.

    python -m benchmarks.location
    python -m benchmarks.location --hard

Each rig is a load simulator with parameters of its own, sound for 40 s and then with an effect
that the model lacks, strong enough to move the output by twice to eight times the noise. The
motion is that of the integrator of `simulate`. The model knows the parameters; its noise is
estimated on the sound rig. The live twin watches in mode `observer`, judged once a second, as in
the node. The port is right if it is the likeliest, or no less likely than that: a law of the
opening is one of the flow, too. Beside it stands whether it is among the ports named, at most two.
--hard has effects that a sensor of the torque alone hardly distinguishes from others.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
import time

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed
from hydro_twin.fitting.noise import estimate_noise
from hydro_twin.live.monitor import Rise
from hydro_twin.live.twin import Twin
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Series
from hydro_twin.simulation.excitation import multisine, random, Run
from hydro_twin.simulation.simulate import Excitation, simulate

PLANT = plant_named('load_simulator')
T = PLANT.sample_time
SOUND, FAULTY = 40.0, 25.0      # [s]; the first is more than the monitor learns from
KNOWN = 10.0                    # of the sound rig, from which noise and reference are taken [s]
NOISE, TORQUE, SHAFT = 0.5, 100.0, 0.02     # [N m], [N m], [rad]
RATIO = 2.0, 8.0                # by how many noises an effect moves the output
FIRST_SEED = 400                # the method was made with seeds below
SAME = 0.1                      # difference of two likelihoods that are the same [nat]

# What moves the output by a strength between 0 and 1, from the largest value at each port.
Make = Callable[[float, Mapping[str, float]], Mapping[str, float]]
EFFECTS: Mapping[str, tuple[tuple[str, str, Make], ...]] = {
    'main': (
        ('command', 'dead_zone', lambda s, r: {'width': s * r['command']}),
        ('command', 'hysteresis', lambda s, r: {'width': s * r['command']}),
        ('spool', 'dead_zone', lambda s, r: {'width': s * r['opening']}),
        ('spool', 'rate_limit', lambda s, r: {'limit': 0.02 * r['rate'] / s}),
        ('leakage', 'leakage', lambda s, r: {'flow': s * r['leakage'], 'exponent': 0.5}),
        ('leakage', 'leakage', lambda s, r: {'flow': s * r['leakage'], 'exponent': 2.0}),
        ('motor', 'friction', lambda s, r: {'coulomb': s * r['force']}),
        ('motor', 'bias', lambda s, r: {'offset': s * r['force']}),
        ('coupling', 'backlash', lambda s, r: {'gap': s * r['twist']}),
        ('coupling', 'stiffening', lambda s, r: {'cubic': 5.0 * s / r['twist'] ** 2}),
        ('sensor', 'bias', lambda s, r: {'offset': s * r['force']}),
        ('sensor', 'lag', lambda s, _: {'time_constant': 0.02 * s})),
    'hard': (
        ('command', 'bias', lambda s, r: {'offset': s * r['command']}),
        ('command', 'lag', lambda s, _: {'time_constant': 0.05 * s}),
        ('flow', 'asymmetry', lambda s, _: {'imbalance': 0.9 * s}),
        ('flow', 'orifice', lambda s, r: {'supply_pressure': r['pressure'] / s})),
}


@dataclass(frozen=True)
class Rig:
    """A rig by its seed, and the effect that it gets: port, effect and what makes it."""

    kind: str
    number: int
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What was said of a rig.

    Attributes:
        port, effect: that it got.
        ratio: RMS of what the effect moves, over the noise.
        rise: as announced; None without an alarm.
        delay: from the alarm to the last sample that was used [s].
        took: processor time of the location [s].
    """

    port: str
    effect: str
    ratio: float
    rise: Rise | None
    delay: float
    took: float

    @property
    def right(self) -> bool:
        """Whether the port is the likeliest, or no less likely than that."""
        where = self.rise and self.rise.location
        return bool(where) and bool(where.ports) and (
            self.port == where.ports[0] or dict(where.others)[self.port] < SAME)

    @property
    def named(self) -> bool:
        """Whether the port is named, with at most one other."""
        where = self.rise and self.rise.location
        return bool(where) and self.port in where.ports and len(where.ports) <= 2


def inputs(duration: float, rng: np.random.Generator) -> tuple[Excitation, Excitation]:
    """Make a command and a motion of the shaft that begin and end at rest, 1 at the most."""
    run = Run(duration, rng)
    made = (multisine(run, highest=rng.uniform(4.0, 12.0)) if rng.random() < 0.6
            else random(run, bandwidth=rng.uniform(2.0, 6.0)))
    turned = random(run, bandwidth=1.5)

    def at_rest(motion: Excitation) -> Excitation:
        def gated(t: FloatArray) -> FloatArray:
            share = np.clip((duration - 1.0 - t) / 0.5, 0.0, 1.0)
            return share ** 2 * (3.0 - 2.0 * share) * motion(t)
        return gated
    return at_rest(made), at_rest(turned)


def strength(model: Model, make: Callable[[float], Placed], driven: FloatArray, wanted: float
             ) -> tuple[Placed, float]:
    """Find the effect that moves the output by so much (RMS), or the strongest."""
    def moved(effects: tuple[Placed, ...]) -> FloatArray:
        return replace(model, effects=effects).system.run(driven, np.zeros(PLANT.order))

    sound, found = moved(()), []
    for size in np.geomspace(1e-3, 1.0, 37).tolist():
        effect = make(size)
        found.append((effect, rms(moved((effect,)) - sound)))
        if found[-1][1] >= wanted:
            break
    return found[-1]


def recorded(rig: Rig) -> tuple[Model, Series, str, str, float]:
    """Draw a rig and its motion; returns model, series, port, effect and its ratio."""
    rng = np.random.default_rng(rig.seed)
    values = PLANT.constant_values() | {
        p.name: float(p.lower * (p.upper / p.lower) ** rng.uniform()) for p in PLANT.parameters}
    model = Model(PLANT, values, T)
    sound = round((SOUND + rng.uniform()) / T) * T      # so that it sets in within a batch
    drives = [(length, *inputs(length, rng)) for length in (sound, FAULTY)]
    t = T * np.arange(round(SOUND / T))
    motion = np.column_stack([drives[0][1](t), SHAFT * drives[0][2](t)])
    reached = np.abs(model.system.run(motion * [1.0, 0.0], np.zeros(PLANT.order))).max()
    motion[:, 0] *= TORQUE / reached
    seen = np.full((len(t), len(model.system.step.H)), np.nan)
    model.system.run(motion, np.zeros(PLANT.order), seen=seen)
    largest = {port.kind: float(np.abs(column).max())
               for port, column in zip(PLANT.ports, seen.T, strict=False)}
    largest['twist'] = largest['coupling'] / values['G']
    port, effect, make = EFFECTS[rig.kind][rig.number]

    def placed(size: float) -> Placed:
        return place(effect, port, make(size, largest), PLANT)

    def driven(length: float, command: Excitation, shaft: Excitation, effects: list[Placed]
               ) -> Series:
        return simulate(PLANT, values, effects, {
            'u_m': lambda t: TORQUE / reached * command(np.floor(t / T + 1e-6) * T),
            'theta_d': lambda t: SHAFT * shaft(t)}, length)

    t = T * np.arange(round(FAULTY / T))
    fault, moved = strength(
        model, placed, np.column_stack([TORQUE / reached * drives[1][1](t),
                                        SHAFT * drives[1][2](t)]),
        NOISE * math.exp(rng.uniform(*np.log(RATIO))))
    parts = [driven(*drive, effects) for drive, effects in zip(drives, ([], [fault]), strict=True)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0].columns}
    columns['T_g'] += NOISE * rng.standard_normal(len(columns['T_g']))
    series = Series(columns, T, 0)
    known = series.part(0, round(KNOWN / T))
    model = replace(model, noise=estimate_noise(model, [known]))
    reference = rms((known['T_g'] - model.run(known, 'observer'))[model.start_up:])
    return (model.with_record(errors={'after': {'observer': {'test': reference}}}), series, port,
            effect, moved / NOISE)


def watched(rig: Rig) -> Outcome:
    """Have the live twin watch a rig until it says where the fault is."""
    model, series, port, effect, ratio = recorded(rig)
    predictor = Analytical(model)
    twin = Twin('', predictor, 'observer')
    moved, measured = predictor.inputs(series), series['T_g'].tolist()
    second = round(1.0 / T)
    for k in range(len(series)):
        twin.step(round(1e9 * k * T), moved[k], measured[k])
        if k % second:
            continue
        rise, begun = twin.judge(), time.process_time()
        if twin.locating:
            while rise is None:
                time.sleep(0.02)
                rise = twin.judge()
        if rise is not None:
            return Outcome(port, effect, ratio, rise, k * T - 1e-9 * rise.end,
                           time.process_time() - begun)
    return Outcome(port, effect, ratio, None, math.nan, math.nan)


def table(outcomes: Sequence[Outcome]) -> None:
    """Print what was said of each rig, and how often it was right."""
    print('| port | effect | noises | said | log-likelihood ratio | next | right | named |')
    print('|---|---|---|---|---|---|---|---|')
    for one in outcomes:
        where = one.rise and one.rise.location
        if not where:
            print(f'| {one.port} | {one.effect} | {one.ratio:.1f} | no alarm | | | no | no |')
            continue
        following = next((f'{name} {less:.0f}' for name, less in where.others
                          if name not in where.ports), '')
        print(f'| {one.port} | {one.effect} | {one.ratio:.1f} | {" or ".join(where.ports)} | '
              f'{where.gain:.0f} | {following} | {"yes" if one.right else "no"} | '
              f'{"yes" if one.named else "no"} |')
    right, named = sum(one.right for one in outcomes), sum(one.named for one in outcomes)
    delays, took = np.array([(one.delay, one.took) for one in outcomes]).T
    count = len(outcomes)
    print(f'\n{right} of {count} right, {100.0 * right / count:.0f} %; {named} named with at most '
          f'one other, {100.0 * named / count:.0f} %; at most '
          f'{np.nanmax(delays + took):.1f} s after the alarm, of which at most '
          f'{np.nanmax(delays):.1f} s for samples and the rest processor time')


def main() -> None:
    """Watch the rigs."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--hard', action='store_true',
                        help='effects that the torque hardly distinguishes from others')
    parser.add_argument('--seed', type=int, default=FIRST_SEED, help='of the first rig')
    parser.add_argument('--turns', type=int, default=2, help='rigs for each effect')
    args = parser.parse_args()
    kind = 'hard' if args.hard else 'main'
    rigs = [Rig(kind, number, args.seed + turn * len(EFFECTS[kind]) + number)
            for number in range(len(EFFECTS[kind])) for turn in range(args.turns)]
    table([watched(rig) for rig in rigs])


if __name__ == '__main__':
    main()
