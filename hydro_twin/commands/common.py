"""What the verbs share: arguments, and what these stand for."""
from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import shlex
from typing import TYPE_CHECKING

from hydro_twin.errors import UserError
from hydro_twin.progress import progress

if TYPE_CHECKING:
    from hydro_twin.api import Data
    from hydro_twin.model import Model
    from hydro_twin.recording.rig import Rig


def add_rig_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what names the rig: --plant, --config and --constant."""
    parser.add_argument('--plant', required=True, metavar='PLANT',
                        help='name of a plant; an unknown name prints the list')
    add_config_argument(parser)
    parser.add_argument('--constant', action='append', default=[], type=assignment,
                        metavar='NAME=VALUE', help='a constant of the rig, as D_m=2.2e-5; '
                        'may be repeated')


def add_config_argument(parser: argparse.ArgumentParser) -> None:
    """Add --config."""
    parser.add_argument('--config', type=Path, metavar='FILE',
                        help='ROS parameter file with signals and constants')


def add_bags(parser: argparse.ArgumentParser) -> None:
    """Add BAG..."""
    parser.add_argument('bags', nargs='+', type=Path, metavar='BAG', help='a rosbag2 recording')


def add_bag_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bags to learn from, BAG..., and those to test on, --test."""
    add_bags(parser)
    parser.add_argument('--test', action='append', default=[], type=Path, metavar='BAG',
                        help='a recording to test on, may be repeated; '
                        'default: the first third of every series')


def add_seed_argument(parser: argparse.ArgumentParser) -> None:
    """Add --seed."""
    parser.add_argument('--seed', type=seed, default=0,
                        help='seed of the random number generator (default: 0)')


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
    from hydro_twin.recording.rig import rig_of

    plant = plant_named(args.plant)
    if model is not None and model.plant.name != plant.name:
        raise UserError(f'{args.model}: a model of {model.plant.name}, not of {plant.name}')
    return rig_of(plant, args.config, dict(args.constant), model)


def data_from(args: argparse.Namespace, rig: Rig, earlier: Sequence[Path] = ()) -> Data:
    """Read BAG... and --test, and earlier recordings.

    Raises:
        BagError: a bag cannot be read, or lacks a signal.
    """
    from hydro_twin.api import read_data

    return read_data(args.bags, args.test, rig, progress, earlier)


def check_folder(path: Path) -> None:
    """Refuse an output that has no folder to go to.

    Raises:
        UserError: there is none.
    """
    if not path.absolute().parent.is_dir():
        raise UserError(f'{path}: there is no folder {path.parent}')


def check_file(path: Path, what: str) -> None:
    """Refuse a file for `what`, a model or a picture, that cannot be made there.

    Raises:
        UserError: there is no folder for it, or a folder in its place.
    """
    check_folder(path)
    if path.is_dir():
        raise UserError(f'{path}: is a folder; a file is needed for the {what}')


def command_line(args: argparse.Namespace) -> str:
    """Return the command that `main` was given, for a model file."""
    return shlex.join(['hydro-twin', *args.argv])
