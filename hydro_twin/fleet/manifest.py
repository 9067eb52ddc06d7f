"""Reads a manifest, the list of the rigs of a fleet, and checks it before anything runs.

A row is a period of a rig: its bags of one date. A CSV table has a line for each, a YAML file a
list of mappings with the same names. docs/fleet.md describes the columns.
"""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import csv
from dataclasses import dataclass
from datetime import date, datetime, UTC
import math
from pathlib import Path
import re
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.plants import plant_named
from hydro_twin.recording.bag import opened
from hydro_twin.recording.rig import rig_of
from hydro_twin.recording.signals import load_yaml, number

NEEDED = ('name', 'plant', 'bags')
OWN = (*NEEDED, 'config', 'constants', 'date', 'group')
EACH = 'each'           # as a date: every bag is a period by itself
DATE = re.compile(r'\d{4}(-\d\d(-\d\d)?)?')


class ManifestError(UserError):
    """The manifest has faults; the message has a line for each."""


@dataclass(frozen=True)
class Task:
    """One trace: a rig in a period.

    Attributes:
        rig: its name.
        plant: the name of its plant.
        bags: absolute paths, in order of time.
        date: of the period, as '2026-03-01'; '' where it is not known.
        measured: whether that is the time of the first message, and not given.
        config: ROS parameter file; None: that of the plant.
        constants: of the rig, in SI units.
        group: of rigs that should be alike.
        labels: further columns of the manifest, such as the site.
    """

    rig: str
    plant: str
    bags: tuple[Path, ...]
    date: str
    measured: bool
    config: Path | None
    constants: tuple[tuple[str, float], ...]
    group: str
    labels: tuple[tuple[str, str], ...]


def read_manifest(path: Path) -> list[Task]:
    """Read a manifest and check all of it.

    Returns:
        The tasks, by rig in the order of the manifest, and by date.

    Raises:
        ManifestError: it has faults, one line each.
        UserError: it cannot be read, or is no manifest at all.
    """
    faults: list[str] = []
    tasks: list[Task] = []
    for place, row in _rows(path):
        try:
            tasks += _tasks(row, path.parent)
        except UserError as error:
            faults.append(f'{path}, {place}: {" ".join(str(error).split())}')
    faults += [f'{path}: {fault}' for fault in _disagreements(tasks)]
    if faults:
        raise ManifestError('\n'.join(faults))
    if not tasks:
        raise ManifestError(f'{path}: has no rows; each names a rig, its plant and its bags')
    order = list(dict.fromkeys(task.rig for task in tasks))
    return sorted(tasks, key=lambda task: (order.index(task.rig), task.date or '~'))


def _rows(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield where each row stands, and its columns; an empty cell is none."""
    if path.suffix in ('.yaml', '.yml'):
        document = load_yaml(path)
        rows = document.get('rigs') if isinstance(document, dict) else document
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise UserError(f"{path} is not a manifest: it needs 'rigs', a list of mappings with "
                            f'{", ".join(NEEDED)}')
        for k, row in enumerate(rows, 1):
            yield f'rig {k}', {str(name): value for name, value in row.items()
                               if value not in (None, '')}
        return
    try:
        with path.open(encoding='utf-8-sig', newline='') as stream:
            reader = csv.DictReader(stream, skipinitialspace=True)
            if missing := sorted(set(NEEDED) - set(reader.fieldnames or ())):
                raise UserError(f'{path}: has no column {", ".join(missing)}; its first line must '
                                f'name the columns, at least {", ".join(NEEDED)}')
            for row in reader:
                if None in row or None in row.values():
                    raise UserError(f'{path}, line {reader.line_num}: has not as many cells as '
                                    'the first line has names')
                yield f'line {reader.line_num}', {name: text.strip() for name, text in row.items()
                                                  if text.strip()}
    except OSError as error:
        raise UserError(f'{path}: {error.strerror}') from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f'{path} is not a CSV table: {error}') from None


def _tasks(row: Mapping[str, Any], folder: Path) -> list[Task]:
    """Make the tasks of a row: one, or one for each of its bags.

    Raises:
        UserError: something in it is wrong.
    """
    if missing := [name for name in NEEDED if name not in row]:
        raise UserError(f'lacks {", ".join(missing)}')
    plant = plant_named(str(row['plant']))
    constants = _constants(row.get('constants', {}))
    config = (folder / str(row['config'])).resolve() if 'config' in row else None
    rig_of(plant, config, dict(constants))
    bags = sorted(_bags(row['bags'], folder), key=_order)
    when = str(row.get('date', ''))
    measured = when in ('', EACH)
    day = '' if measured else _date(when)
    labels = tuple((name, str(value)) for name, value in row.items() if name not in OWN)
    periods = [(bag,) for bag in bags] if when == EACH else [tuple(bags)]
    return [Task(str(row['name']), plant.name, period, _first_day(period) if measured else day,
                 measured, config, constants, str(row.get('group', plant.name)), labels)
            for period in periods]


def _bags(given: Any, folder: Path) -> list[Path]:
    """Find the bags of one or several globs, relative to the manifest.

    Raises:
        UserError: one matches nothing, or is no glob.
    """
    patterns = given if isinstance(given, list) else str(given).split(';')
    found: dict[Path, None] = {}
    for pattern in (str(pattern).strip() for pattern in patterns):
        whole = Path(pattern)
        root, relative = ((Path(whole.anchor), str(whole.relative_to(whole.anchor)))
                          if whole.is_absolute() else (folder, pattern))
        try:
            # Of the folder itself, '.', `glob` makes an error of Python.
            paths = sorted(root.glob(relative)) if Path(relative).parts else []
        except (ValueError, NotImplementedError) as error:
            raise UserError(f'bags: {pattern!r} is no pattern of files: {error}') from None
        if not paths:
            raise UserError(f'bags: nothing matches {pattern!r} in {root}')
        found |= dict.fromkeys(path.resolve() for path in paths)
    return list(found)


def _order(bag: Path) -> tuple[float, str]:
    """Sort bags by the time of their first message; broken ones last."""
    start = _start(bag)
    return (math.inf if start is None else start), str(bag)


def _start(bag: Path) -> float | None:
    """Read the time of the first message [ns]; None where a bag cannot be read.

    A broken bag is no fault of the manifest: its trace fails, and its row says why.
    """
    try:
        with opened(bag) as reader:
            return float(reader.start_time) if reader.message_count else None
    except (UserError, OSError):
        return None


def _first_day(bags: Sequence[Path]) -> str:
    """Date a period by its first bag; '' where that cannot be read."""
    start = _start(bags[0])
    return '' if start is None else datetime.fromtimestamp(start * 1e-9, UTC).isoformat(
        timespec='seconds').removesuffix('+00:00')


def _date(text: str) -> str:
    """Complete a date, '2026-03' or '2026', to its first day.

    Raises:
        UserError: it is none.
    """
    try:
        if DATE.fullmatch(text):
            return date.fromisoformat((text + '-01-01')[:10]).isoformat()
        return datetime.fromisoformat(text).replace(tzinfo=None).isoformat()
    except ValueError:
        raise UserError(f"date {text!r} should read like 2026-03-01 or 2026-03, or '{EACH}' where "
                        'every bag is a period by itself') from None


def _constants(given: Any) -> tuple[tuple[str, float], ...]:
    """Read 'D_m=2.2e-5; beta=1', or a mapping.

    Raises:
        UserError: it is neither.
    """
    if isinstance(given, dict):
        return tuple((str(name), number(value, f'constant {name}'))
                     for name, value in given.items())
    pairs = [part.partition('=') for part in str(given).split(';') if part.strip()]
    if any(not name.strip() or not equals for name, equals, _ in pairs):
        raise UserError(f'constants {given!r} should read like D_m=2.2e-5; V=1e-4')
    return tuple((name.strip(), number(value, f'constant {name.strip()}'))
                 for name, _, value in pairs)


def _disagreements(tasks: Sequence[Task]) -> list[str]:
    """Say which rows of one rig contradict each other."""
    said: list[str] = []
    by_rig: dict[str, list[Task]] = {}
    for task in tasks:
        by_rig.setdefault(task.rig, []).append(task)
    for rig, own in by_rig.items():
        for what in ('plant', 'group'):
            if len(values := sorted({str(getattr(task, what)) for task in own})) > 1:
                said.append(f'rig {rig} has more than one {what}: {", ".join(values)}')
                break               # the plant stands for a group that is not given
        bags = [bag for task in own for bag in task.bags]
        said += [f'rig {rig} has {bag} in more than one period'
                 for bag in dict.fromkeys(bags) if bags.count(bag) > 1]
        given = [task.date for task in own if task.date and not task.measured]
        said += [f'rig {rig} has more than one row of the date {one}'
                 for one in dict.fromkeys(given) if given.count(one) > 1]
    for group in dict.fromkeys(task.group for task in tasks):
        if len(plants := sorted({task.plant for task in tasks if task.group == group})) > 1:
            said.append(f'group {group} has rigs of {" and ".join(plants)}, which cannot be '
                        'compared')
    return said
