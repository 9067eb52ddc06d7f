"""hydro-twin simulate: a recording made from the physics, with any effects, noise, excitation."""
from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.common import (
    add_rig_arguments,
    add_seed_argument,
    assignment,
    rig_from,
)
from hydro_twin.commands.verb import Verb
from hydro_twin.errors import DataError, UserError
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from numpy.random import Generator
    from rich.console import Console

    from hydro_twin.effects import Placed
    from hydro_twin.plants import Plant
    from hydro_twin.recording.rig import Rig
    from hydro_twin.recording.series import Series
    from hydro_twin.simulation.excitation import Spec
    from hydro_twin.simulation.simulate import Excitation

START = 1_000_000_000_000                   # stamp of the first sample [ns]
PAUSE = 1_000_000_000                       # between two series [ns] ...
PAUSE_SAMPLES = 10                          # ... and at least, so that series are kept apart
SHARES = (0.5, 0.2)                         # of a large output: first input, each of the others
WITHIN = 0.4                                # of the range of the output, about its middle
B19 = (1.0, 7.0, 9.0)                       # frequencies of the first input [Hz], as in [B19] ...
PERIOD = 10                                 # ... or as much slower as gives each so many samples


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_rig_arguments(parser)
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='BAG',
                        help='the bag to make; must not exist')
    parser.add_argument('--set', action='append', default=[], type=assignment,
                        metavar='NAME=VALUE', help='a parameter, as J=0.05; may be repeated '
                        '(default: the geometric middle of the search box)')
    parser.add_argument('--effect', action='append', default=[], metavar='ID@PORT:NAME=VALUE,...',
                        help="what the linear plant lacks, as 'friction@motor:coulomb=10'; "
                        'may be repeated')
    parser.add_argument('--excitation', action='append', default=[],
                        metavar='INPUT=KIND:NAME=VALUE,...',
                        help="as 'u_m=sine:frequency=7,amplitude=0.3'; kinds are sine "
                        '(frequency), multisine (lowest, highest, lines), chirp (first, last), '
                        'steps (shortest, longest) and random (bandwidth), in Hz or s, each with '
                        'amplitude and offset as well. Repeated for one input, each makes one '
                        'more series. Default: on the first input sinusoids of 1, 7 and 9 Hz, '
                        'random motion on the others; an amplitude that suits the linear plant, '
                        'about the middle of its range if it has one; slower where samples are '
                        'rare')
    parser.add_argument('--burst', action='append', default=[],
                        metavar='INPUT:begin=S,length=S,frequency=HZ,amplitude=VALUE',
                        help='a vibration on top of the excitation of an input, in every series; '
                        'may be repeated')
    parser.add_argument('--duration', type=float, default=3.0, metavar='SECONDS',
                        help='duration of each series (default: 3)')
    parser.add_argument('--snr', type=float, metavar='DB',
                        help='noise on the output: signal to noise ratio of each series')
    parser.add_argument('--noise', type=float, default=0.0, metavar='RMS',
                        help='noise on the output, in its unit')
    parser.add_argument('--sensor', action='append', default=[], metavar='NAME[:noise=RMS]',
                        help="something else that is measured, as p_L or 'p_L:noise=2e4', with "
                        'noise in its unit (default: at the --snr); may be repeated')
    parser.add_argument('--quantisation', type=float, default=0.0, metavar='STEP',
                        help='quantisation step of the output, in its unit')
    add_seed_argument(parser)


@dataclass(frozen=True)
class _Job:
    """What is simulated, with which measurements.

    Attributes:
        values: parameters and constants of the plant, in SI units.
        sensors: what else is measured -> its noise RMS; None: at the ratio of the output.
        drives: for every series, what drives each input.
        bursts: what is added to an input, in every series.
    """

    plant: Plant
    values: dict[str, float]
    effects: Sequence[Placed]
    sample_time: float
    sensors: Mapping[str, float | None]
    drives: Sequence[Sequence[Spec]]
    bursts: Sequence[tuple[str, Excitation]]


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate every series, and write the bag; returns the truth, which the bag does not hold.

    Raises:
        UserError: an option is wrong, or the bag exists already.
        DataError: the plant diverges.
    """
    from hydro_twin.recording.write import write_recording

    rig = rig_from(args)
    _check(args, rig.clock.unrecorded)
    job = _job(args, rig)
    plant, sensors = job.plant, job.sensors
    series, truth = _simulated(args, job)
    signals = rig.signals | {name: rig.sensors[name] for name in sensors}
    write_recording(args.output, series, signals, {'origin': 'simulated, not measured'})
    return {
        'bag': str(args.output),
        'plant': plant.name,
        'sample_time': job.sample_time,
        'samples': sum(map(len, series)),
        'parameters': {p.name: {'value': job.values[p.name], 'unit': p.unit}
                       for p in plant.parameters},
        'constants': rig.constants,
        'effects': [_described(placed) for placed in job.effects],
        'series': truth,
        'seed': args.seed,
    }


def _check(args: argparse.Namespace, sample_time: float) -> None:
    """Refuse a bag that exists already, and numbers that make no recording."""
    if args.output.exists():
        raise UserError(f'{args.output} exists already: it is not overwritten')
    if not sample_time * 10 <= args.duration < float('inf'):
        raise UserError(f'--duration {args.duration:g}: at least ten samples, '
                        f'{10 * sample_time:g} s')
    if not (0 <= args.noise < float('inf') and 0 <= args.quantisation < float('inf')):
        raise UserError('--noise and --quantisation must be finite, and not below zero')
    if args.snr is not None and not abs(args.snr) < float('inf'):
        raise UserError(f'--snr {args.snr:g}: must be finite')


def _job(args: argparse.Namespace, rig: Rig) -> _Job:
    """Read what is to be simulated."""
    from hydro_twin.model import place
    from hydro_twin.simulation.excitation import settings_of

    plant, sample_time = rig.plant, rig.clock.unrecorded
    parameters = plant.middle() | dict(args.set)
    plant.check(parameters)
    effects = []
    for text in args.effect:
        head, _, rest = text.partition(':')
        identifier, _, port = head.partition('@')
        effects.append(place(identifier, port, settings_of(text, rest), plant))
    sensors = _sensors(args.sensor, plant)
    if missing := sensors.keys() - rig.sensors.keys():
        raise UserError(f'{args.config}: no signal {", ".join(sorted(missing))}, which --sensor '
                        'asks for')
    return _Job(plant, {**rig.constants, **parameters}, effects, sample_time, sensors,
                _excitations(args.excitation, plant, sample_time), _bursts(args.burst, plant))


def _simulated(args: argparse.Namespace, job: _Job) -> tuple[list[Series], list[dict[str, Any]]]:
    """Simulate and measure every series; returns them, and what is true of each."""
    import numpy as np

    from hydro_twin.simulation.sensor import measure
    from hydro_twin.simulation.simulate import BLOCK, simulate

    output, step = job.plant.output.name, job.sample_time * 1e9
    rng = np.random.default_rng(args.seed)
    series: list[Series] = []
    truth, start = [], START
    blocks = len(job.drives) * round(args.duration / job.sample_time / BLOCK)
    with progress('simulating', blocks) as tick:
        for specs in job.drives:
            one = simulate(job.plant, job.values, job.effects,
                           _inputs(job, specs, args.duration, rng), args.duration, start, tick,
                           job.sample_time, [*job.sensors])
            if not np.isfinite(one[output]).all():
                raise DataError(f'{job.plant.name} diverges with these values')
            noisy, noise = measure(one, output, args.snr, args.noise, args.quantisation, rng)
            noises = {output: noise}
            for name, own in job.sensors.items():
                noisy, noises[name] = measure(noisy, name, args.snr if own is None else None,
                                              own or 0.0, 0.0, rng)
            series.append(noisy)
            truth.append({
                'excitation': {signal.name: spec.kind
                               for signal, spec in zip(job.plant.inputs, specs, strict=True)},
                'largest': {name: float(np.abs(one[name]).max()) for name in one.columns},
                'noise': noise,
                **({'noises': noises} if job.sensors else {})})
            start += round(len(one) * step) + max(PAUSE, round(PAUSE_SAMPLES * step))
    return series, truth


def _inputs(job: _Job, specs: Sequence[Spec], duration: float, rng: Generator
            ) -> dict[str, Excitation]:
    """Make what drives each input of one series, with the bursts on top."""
    from hydro_twin.simulation.excitation import make, Run

    laws = job.plant.laws(job.values)
    middle, largest = _reach(job.plant)
    inputs = {
        signal.name: make(spec, Run(duration, rng), laws, column,
                          SHARES[column > 0] / SHARES[0] * largest, job.sample_time,
                          0.0 if column else middle)
        for column, (signal, spec) in enumerate(zip(job.plant.inputs, specs, strict=True))}
    for name, burst in job.bursts:
        inputs[name] = _sum(inputs[name], burst)
    return inputs


def _reach(plant: Plant) -> tuple[float, float]:
    """Say about which output, and how far from it, the first input drives by default."""
    if plant.output_range is None:
        return 0.0, SHARES[0] * plant.output_scale
    low, high = plant.output_range
    return 0.5 * (low + high), WITHIN * (high - low)


def _excitations(texts: list[str], plant: Plant, sample_time: float) -> list[list[Spec]]:
    """Say for every series what drives each input."""
    from hydro_twin.simulation.excitation import parse

    given: dict[str, list[Spec]] = {signal.name: [] for signal in plant.inputs}
    for text in texts:
        name, _, rest = text.partition('=')
        _known(name, plant)
        given[name].append(parse(rest))
    first, *others = given
    slower = min(1.0, 1.0 / (PERIOD * max(B19) * sample_time))
    given[first] = given[first] or [parse(f'sine:frequency={slower * f:.3g}') for f in B19]
    for name in others:
        given[name] = given[name] or [parse('random')]
    count = max(map(len, given.values()))
    for name, specs in given.items():
        if len(specs) not in (1, count):
            raise UserError(f'{len(specs)} excitations for {name} but {count} series: give one '
                            'for all, or one for each')
    return [[specs[min(k, len(specs) - 1)] for specs in given.values()] for k in range(count)]


def _bursts(texts: list[str], plant: Plant) -> list[tuple[str, Excitation]]:
    """Say what is added to which input."""
    from hydro_twin.simulation.excitation import parse_burst

    bursts = [parse_burst(text) for text in texts]
    for name, _ in bursts:
        _known(name, plant)
    return bursts


def _sensors(texts: list[str], plant: Plant) -> dict[str, float | None]:
    """Say what else is measured, and with which noise; None: at the ratio of the output."""
    from hydro_twin.simulation.excitation import settings_of

    found: dict[str, float | None] = {}
    known = [sensor.name for sensor in plant.sensors]
    for text in texts:
        name, _, rest = text.partition(':')
        if name not in known:
            raise UserError(f'{plant.name} has no sensor {name!r}; it has '
                            f'{", ".join(known) or "none"}')
        settings = settings_of(text, rest)
        if settings.keys() - {'noise'} or not 0 <= settings.get('noise', 0.0) < float('inf'):
            raise UserError(f'--sensor {text}: takes noise=RMS, not below zero')
        found[name] = settings.get('noise')
    return found


def _sum(one: Excitation, other: Excitation) -> Excitation:
    return lambda t: one(t) + other(t)


def _known(name: str, plant: Plant) -> None:
    """Refuse what is no input of the plant."""
    names = [signal.name for signal in plant.inputs]
    if name not in names:
        raise UserError(f'{plant.name} has no input {name!r}; it has {", ".join(names)}')


def _described(placed: Placed) -> dict[str, Any]:
    """Lay out an effect as in a report."""
    return {'id': placed.effect.id, 'port': placed.port.name, 'parameters': {
        p.name: {'value': value, 'unit': placed.effect.unit(p, placed.port)}
        for p, value in zip(placed.effect.parameters, placed.values, strict=True)}}


def show(result: dict[str, Any], console: Console) -> None:
    """Print what was made."""
    console.print(f'{result["bag"]}: {result["samples"]} samples of {result["plant"]} in '
                  f'{len(result["series"])} series')
    for effect in result['effects']:
        values = ', '.join(f'{name} {p["value"]:g} {p["unit"]}'
                           for name, p in effect['parameters'].items())
        console.print(f'  with {effect["id"]} at {effect["port"]}: {values}')
    for one in result['series']:
        kinds = ', '.join(f'{name} {kind}' for name, kind in one['excitation'].items())
        reach = ', '.join(f'{name} {value:.4g}' for name, value in one['largest'].items())
        console.print(f'  {kinds}; largest {reach}; noise {one["noise"]:.3g} RMS')


VERB = Verb('simulate', 'make a recording from the physics', add_arguments, run, show)
