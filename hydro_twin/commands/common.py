"""What the verbs share: arguments, what these stand for, and a display of progress."""
from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_twin.errors import UserError

if TYPE_CHECKING:
    from hydro_twin.model import Model
    from hydro_twin.plants import Plant
    from hydro_twin.recording.clock import Clock
    from hydro_twin.recording.series import Recording
    from hydro_twin.recording.signals import SignalMap

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Rig:
    """The plant at hand, and what is known of this copy of it.

    Attributes:
        constants: all constants of the plant, in SI units.
        signals: where the plant's inputs and its output are found in messages.
        clock: what is known of the sample time before a recording is read.
    """

    plant: Plant
    constants: dict[str, float]
    signals: dict[str, SignalMap]
    clock: Clock


def add_rig_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what names the rig: --plant, --config and --constant."""
    parser.add_argument('--plant', required=True, metavar='PLANT',
                        help='name of a plant; an unknown one lists those there are')
    add_config_argument(parser)
    parser.add_argument('--constant', action='append', default=[], type=assignment,
                        metavar='NAME=VALUE', help='a constant of the rig, as D_m=2.2e-5; '
                        'may be repeated')


def add_config_argument(parser: argparse.ArgumentParser) -> None:
    """Add --config."""
    parser.add_argument('--config', type=Path, metavar='FILE',
                        help='ROS parameter file with signals and constants')


def add_bag_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bags to learn from, BAG..., and those to test on, --test."""
    parser.add_argument('bags', nargs='+', type=Path, metavar='BAG', help='a rosbag2 recording')
    parser.add_argument('--test', action='append', default=[], type=Path, metavar='BAG',
                        help='a recording to test on, may be repeated; '
                        'default: the first third of every series')


def add_seed_argument(parser: argparse.ArgumentParser) -> None:
    """Add --seed."""
    parser.add_argument('--seed', type=seed, default=0, help='of all that is random (default: 0)')


def seed(text: str) -> int:
    """Read a seed.

    Raises:
        argparse.ArgumentTypeError: it is no whole number, or below zero.
    """
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f'{text!r} should be a whole number, 0 or above')
    return int(text)


def assignment(text: str) -> tuple[str, float]:
    """Split NAME=VALUE.

    Raises:
        argparse.ArgumentTypeError: it is not of that form.
    """
    name, equals, value = text.partition('=')
    try:
        if not name or not equals:
            raise ValueError
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} should read like D_m=2.2e-5') from None


def rig_from(args: argparse.Namespace, model: Model | None = None) -> Rig:
    """Gather what --plant, --config and --constant say of the rig; `model` is that of --model.

    Raises:
        UserError: one of them is wrong, or the model is of another plant.
    """
    from hydro_twin.plants import plant_named

    plant = plant_named(args.plant)
    if model is not None and model.plant.name != plant.name:
        raise UserError(f'{args.model}: a model of {model.plant.name}, not of {plant.name}')
    return rig_of(plant, args.config, dict(args.constant), model)


def rig_of(plant: Plant, config: Path | None = None, constants: dict[str, float] | None = None,
           model: Model | None = None) -> Rig:
    """Gather what a configuration says of a plant; `constants` take precedence over it.

    Args:
        plant: the plant.
        config: ROS parameter file.
        constants: of the rig.
        model: that the job runs, whose clock is then the usual one.

    Raises:
        UserError: the configuration or a constant is wrong.
    """
    from hydro_twin.recording.clock import clock_of
    from hydro_twin.recording.signals import load_constants, load_parameters, load_signals

    signals = load_signals(plant.name, [signal.name for signal in plant.signals], config)
    given = load_parameters(config) if config else {}
    clock = clock_of(plant, given, str(config), model.sample_time if model else None)
    values = plant.constant_values(load_constants(plant.name, config) | (constants or {}))
    return Rig(plant, values, signals, clock)


def read(bags: Sequence[Path], rig: Rig) -> Recording:
    """Read bags on one clock, commands held and measurements interpolated.

    Raises:
        BagError: a bag cannot be read, or lacks a signal.
    """
    return read_apart([bags], rig)[0]


def read_apart(groups: Sequence[Sequence[Path]], rig: Rig) -> list[Recording]:
    """Read groups of bags as a recording each, all on one clock, which the slowest bag sets.

    Raises:
        BagError: a bag cannot be read, or lacks a signal.
    """
    from hydro_twin.recording.bag import read_signals
    from hydro_twin.recording.clock import slowest
    from hydro_twin.recording.read import read_recording

    held = {signal.name for signal in rig.plant.signals if signal.held}
    measured = {name: signal for name, signal in rig.signals.items() if name not in held}
    with progress('reading'):
        periods = {} if rig.clock.given else {
            bag: slowest(read_signals(bag, measured), held) for bags in groups for bag in bags}
        sample_time = rig.clock.over(periods.values())
        if any(rig.clock.over([period]) < sample_time for period in periods.values()):
            log.warning('all bags are read at %g s, the sample time of the slowest, %s',
                        sample_time, max(periods, key=lambda path: periods[path]))
        return [read_recording(bags, rig.signals, held, sample_time) for bags in groups]


def train_and_test(args: argparse.Namespace, rig: Rig) -> tuple[Recording, Recording]:
    """Read BAG... and --test; without the latter, the first third of every series tests [B19].

    Returns:
        (train, test).

    Raises:
        BagError: a bag cannot be read, or lacks a signal.
    """
    from hydro_twin.recording.series import split

    if args.test:
        train, test = read_apart([args.bags, args.test], rig)
        return train, test
    return split(read(args.bags, rig))


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Callable[[], None]]:
    """Show on standard error that something takes time.

    Args:
        what: is being done.
        total: number of steps; None if that is not known.

    Yields:
        A function to call after each step.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    # Rich ends its display with an empty line, which in a log would stand before an error's one.
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)
