"""The rig of a job: its plant, what its configuration says, and the bags recorded on it."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
import logging
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.errors import UserError
from hydro_twin.progress import Progress, silent
from hydro_twin.recording.bag import read_signals
from hydro_twin.recording.clock import Clock, clock_of, slowest
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.read import on_grid
from hydro_twin.recording.series import Recording, Series
from hydro_twin.recording.signals import load_constants, load_parameters, load_signals, SignalMap

if TYPE_CHECKING:
    from hydro_twin.model import Model
    from hydro_twin.plants import Plant

log = logging.getLogger(__name__)

READ = ('plant', 'sample_time', 'follow', 'signals', 'constants')   # of a configuration
ALIKE = 0.85    # share of letters from which another name is one of these, misspelt


@dataclass(frozen=True)
class Rig:
    """The plant, and what is known of this rig.

    Attributes:
        constants: all constants of the plant, in SI units.
        signals: where the plant's inputs and its output are found in messages.
        sensors: where else something is measured that the plant declares; a bag may lack it.
        clock: what is known of the sample time before a recording is read.
        follow: parameters that an observer is to follow, NAME or NAME=RATE.
    """

    plant: Plant
    constants: dict[str, float]
    signals: dict[str, SignalMap]
    clock: Clock
    sensors: dict[str, SignalMap] = field(default_factory=dict)
    follow: tuple[str, ...] = ()


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
    needed = [signal.name for signal in plant.signals]
    found = load_signals(plant.name, needed, config, [sensor.name for sensor in plant.sensors])
    sensors = {name: found.pop(name) for name in [*found] if name not in needed}
    given = load_parameters(config) if config else {}
    for name in {key.split('.')[0] for key in given} - set(READ):
        if meant := get_close_matches(name, READ, 1, ALIKE):    # others are of other nodes
            raise UserError(f'{config}: no parameter {name!r}; is {meant[0]!r} meant?')
    clock = clock_of(plant, given, str(config), model.sample_time if model else None)
    values = plant.constant_values(load_constants(plant.name, config) | (constants or {}))
    return Rig(plant, values, found, clock, sensors, _follow(given, str(config)))


def _follow(parameters: Mapping[str, Any], source: str) -> tuple[str, ...]:
    """Return the parameters to follow, NAME or NAME=RATE; as the node has it, '' means none.

    Args:
        parameters: of the configuration, flat.
        source: where they come from.

    Raises:
        UserError: they are not a list of texts.
    """
    value = parameters.get('follow')
    if nested := {key.partition('.')[2]: rate for key, rate in parameters.items()
                  if key.startswith('follow.')}:
        value = nested
    if value is None:
        return ()
    if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
        raise UserError(f'{source}: follow must be a list of NAME or NAME=RATE, not {value!r}')
    return tuple(value)


def read(bags: Sequence[Path], rig: Rig, show: Progress = silent) -> Recording:
    """Read bags on one clock, commands held and measurements interpolated.

    Raises:
        BagError: a bag cannot be read, or lacks a signal.
    """
    return read_apart([bags], rig, show)[0]


def read_apart(groups: Sequence[Sequence[Path]], rig: Rig, show: Progress = silent
               ) -> list[Recording]:
    """Read groups of bags as a recording each, all on one clock, which the slowest bag sets.

    Raises:
        BagError: a bag cannot be read, or lacks a signal.
    """
    held = {signal.name for signal in rig.plant.signals if signal.held}
    bags = list(dict.fromkeys(Path(bag) for group in groups for bag in group))
    periods: dict[Path, float] = {}
    at: dict[Path, float] = {}
    series: dict[Path, list[Series]] = {}

    def take(bag: Path) -> None:
        """Read a bag at the sample time of the slowest so far."""
        samples = read_signals(bag, rig.signals | rig.sensors, rig.sensors)
        sensors = {name: samples.pop(name) for name in rig.sensors if name in samples}
        periods[bag] = slowest(samples, held)
        at[bag] = rig.clock.over(periods.values())
        series[bag] = on_grid(bag, samples, held, at[bag], sensors)

    with show('reading', None):
        for bag in bags:
            take(bag)
        sample_time = rig.clock.over(periods.values())
        for bag in bags:        # again, where a slower one came after it
            if at[bag] != sample_time:
                take(bag)
        if any(rig.clock.over([period]) < sample_time for period in periods.values()):
            log.warning('all bags are read at %g s, the sample time of the slowest, %s',
                        sample_time, max(periods, key=lambda path: periods[path]))
        return [Recording(tuple(one for bag in group for one in series[Path(bag)]),
                          tuple(source_of(Path(bag)) for bag in group)) for group in groups]
