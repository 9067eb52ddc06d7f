"""Random cylinders and axes with more physics than the plants have, recorded, traced and counted.

python -m benchmarks.tracing.machines -o out/machines.jsonl --count 18
python -m benchmarks.tracing.machines -o out/machines_held_out.jsonl --count 18 --seeds held_out
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from benchmarks.tracing.cases import BLOCK, FIRST_SEED
from benchmarks.tracing.figures import Line, named, read
from benchmarks.tracing.machine_laws import (
    Axis,
    Cylinder,
    move_axis,
    move_cylinder,
    on_fine_steps,
    steady_speeds,
    STEP,
)
from benchmarks.tracing.run import add_trace, arguments, complete, seeds_of
from benchmarks.tracing.signals import FloatArray, Generator
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series

KINDS = ('cylinder', 'axis')
SERIES = 3
RATES = (500.0, 100.0, 20.0)
EXCITATIONS = ('steps', 'operator', 'loop')
LEAST = 0.04            # imbalance of the speeds from which it counts
DYNAMICS = ('delay', 'lag', 'mode')     # each machine has more of them than its plant


@dataclass(frozen=True)
class Machine:
    """A recording of a machine, and what is in it that its plant lacks.

    Attributes:
        effects: to be named.
        also: in it, too, but so little or so alike that a name is neither right nor wrong.
    """

    plant: str
    effects: tuple[str, ...]
    also: tuple[str, ...]
    series: tuple[dict[str, FloatArray], ...]
    rate: float
    excitation: str
    fields: dict[str, float]

    def recording(self) -> Recording:
        """Return the series as the product reads them from bags."""
        return Recording(tuple(
            Series(columns, 1.0 / self.rate, start=i * 1_000_000_000_000, source='machine')
            for i, columns in enumerate(self.series)))


def make_machine(seed: int) -> Machine:
    """Draw a machine and record it."""
    block, index = divmod(seed % FIRST_SEED['held_out'], BLOCK)
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    return (_cylinder if KINDS[block] == 'cylinder' else _axis)(index, rng)


def _cylinder(index: int, rng: Generator) -> Machine:
    excitation, rate = EXCITATIONS[index % 3], RATES[index // 3 % 3]
    area, supply = rng.uniform(5e-4, 3e-3), rng.uniform(7e6, 20e6)
    stroke, fastest = rng.uniform(0.15, 0.8), rng.uniform(0.08, 0.4)
    dead_volume, stiffness = 0.1 * area * stroke + 5e-5, rng.uniform(6e8, 1.3e9)
    mode = 2 * math.pi * rng.uniform(6.0, 30.0)
    ratio = rng.choice([1.0, rng.uniform(0.5, 0.85)])
    mass = 4 * stiffness * area**2 / ((area * stroke + 2 * dead_volume) * mode**2)
    load = supply * area * rng.choice([0.0, rng.uniform(-0.25, 0.25)])
    c = Cylinder(
        supply, area, ratio, stroke, area * fastest / math.sqrt(0.5 * supply), stiffness,
        dead_volume, rng.uniform(0.0, 2e-12), 2 * math.pi * rng.uniform(12.0, 60.0),
        rng.uniform(0.6, 1.0), mass, rng.uniform(0.05, 0.4) * mode * mass,
        rng.uniform(0.0, 0.03) * supply * area, load)
    effects = []
    out, back = steady_speeds(c)
    if abs(out - back) > LEAST * (out + back):
        effects.append('asymmetry')
    if rng.random() < 0.5:
        up, down = rng.uniform(0.02, 0.15, 2) if rng.random() < 0.5 else [
            rng.uniform(0.02, 0.15)] * 2
        c = c._replace(overlap_up=up, overlap_down=down)
        effects.append('dead_zone')
    if excitation != 'loop' and rng.random() < 0.25:
        c = c._replace(most=rng.uniform(0.5, 0.8))
        effects.append('saturation')
    every, series = round(1.0 / rate / STEP), []
    seconds = 20.0 if rate > 50.0 else 60.0
    fine = rng.uniform(0.5, 2.0) * stroke / 4096
    touched = False
    for _ in range(SERIES):
        times = np.cumsum(rng.uniform(0.3, 2.5, 400) * (stroke / fastest / 3.0))
        levels, gain = rng.uniform(-1.0, 1.0, 401), 0.0
        begin = 0.5 * stroke
        if excitation == 'loop':
            levels, gain = begin + 0.35 * stroke * levels, rng.uniform(3.0, 8.0) / fastest
            levels[0] = begin
        else:
            # Out and in by turns, so that it travels through its stroke and meets its ends.
            levels = np.abs(levels) * np.resize([1.0, -1.0], 401)
        given = on_fine_steps(np.concatenate(([0.0], times)), levels, seconds,
                              smooth=excitation == 'operator')
        x, u = move_cylinder(c, begin, given, gain, every)
        touched |= bool(x.min() < 1e-4 * stroke or x.max() > (1 - 1e-4) * stroke)
        series.append({'command': 10.0 * u, 'x': fine * np.round(x / fine)
                       + 0.3 * fine * rng.standard_normal(len(x))})
    if touched:
        effects.append('end_stop')
    # Oil that leaks past the piston lets it creep; every valve is an orifice, and every load more
    # or less viscous.
    return Machine('cylinder', tuple(sorted(effects)), (*DYNAMICS, 'bias', 'orifice'),
                   tuple(series), rate, excitation, c._asdict())


def _axis(index: int, rng: Generator) -> Machine:
    rate = (1000.0, 250.0)[index % 2]
    mass = math.exp(rng.uniform(0.0, math.log(200.0)))
    reach, fastest = rng.uniform(0.1, 0.5), rng.uniform(0.2, 0.8)
    accelerates = rng.uniform(2.0, 6.0)
    most = mass * accelerates * 2.5
    coulomb = mass * accelerates * rng.choice([0.0, rng.uniform(0.05, 0.4)], p=[0.2, 0.8])
    bias = mass * accelerates * rng.choice([0.0, rng.uniform(0.03, 0.15)]) * rng.choice([-1, 1])
    mode, share = 2 * math.pi * rng.uniform(30.0, 80.0), rng.uniform(0.02, 0.1)
    a = Axis(mass, rng.uniform(0.1, 1.0) * mass * accelerates / fastest, coulomb,
             rng.uniform(1.0, 1.5), rng.uniform(0.005, 0.03), bias,
             rng.uniform(5e-4, 3e-3), share * mass,
             share * mass * mode**2, 0.04 * share * mass * mode)
    effects = [name for name, size in (('bias', bias), ('friction', coulomb)) if size]
    loop, series = 2 * math.pi * rng.uniform(3.0, 8.0), []
    every, fine = round(1.0 / rate / STEP), math.exp(rng.uniform(math.log(2e-7), math.log(1e-5)))
    for _ in range(SERIES):
        seconds = 12.0
        at = STEP * np.arange(round(seconds / STEP))
        if index // 2 % 2:
            f = rng.uniform(0.1, 2.0, 5)
            wave = np.sin(2 * np.pi * np.outer(at, f) + rng.uniform(0, 2 * np.pi, 5)) @ (
                1.0 / f)
            wave *= min(reach / np.abs(wave).max(), fastest * STEP / np.abs(np.diff(wave)).max())
        else:
            times = np.cumsum(rng.uniform(0.5, 1.5, 60))
            corners = np.concatenate(([0.0], reach * rng.uniform(-1.0, 1.0, 60)))
            wave = np.interp(at, np.concatenate(([0.0], times)), corners)
        x, force = move_axis(a, wave, mass * loop**2, 1.4 * mass * loop, most, every)
        series.append({'force': force, 'x': fine * np.round(x / fine)})
    return Machine('positioning', tuple(effects), (*DYNAMICS, 'flexible_load'), tuple(series),
                   rate, 'loop', a._asdict())


def trace_machine(seed: int) -> dict[str, Any]:
    """Return the truth, what the tracer said ('report' or 'failure') and how long it took."""
    machine = make_machine(seed)
    line: dict[str, Any] = {
        'seed': seed, 'kind': machine.plant, 'effects': list(machine.effects),
        'also': list(machine.also),
        'rate': machine.rate, 'excitation': machine.excitation, 'truth': machine.fields}
    add_trace(line, machine.recording(), plant_named(machine.plant))
    return line


def outcome(line: Line) -> str:
    """Judge a trace: 'right', 'part', 'wrong' (a name that is not there), 'none' or 'failure'.

    Right is also a machine that lacks nothing of which nothing is named.
    """
    if 'failure' in line:
        return 'failure'
    names, there = set(named(line)) - set(line['also']), set(line['effects'])
    if names - there:
        return 'wrong'
    return 'right' if names == there else 'part' if names else 'none'


def table(lines: Sequence[Line]) -> str:
    """Count the outcomes, of all and by how the machine was driven, as Markdown."""
    kinds = ('right', 'part', 'none', 'wrong', 'failure')
    rows = ['| machine | ' + ' | '.join(kinds) + ' |', '|---' * (len(kinds) + 1) + '|']
    for title in sorted({f"{x['kind']}, {x['excitation']}, {x['rate']:.0f} Hz" for x in lines}):
        count = Counter(outcome(x) for x in lines
                        if f"{x['kind']}, {x['excitation']}, {x['rate']:.0f} Hz" == title)
        rows.append(f'| {title} | ' + ' | '.join(str(count[kind]) for kind in kinds) + ' |')
    return '\n'.join(rows)


def main() -> None:
    """Trace the machines that the file lacks, then print the figures of all in it."""
    asked = arguments(__doc__, KINDS, 18)
    complete(asked.output, seeds_of(asked, KINDS), trace_machine, asked.workers)
    print(table(read(asked.output)))


if __name__ == '__main__':
    main()
