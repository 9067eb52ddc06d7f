"""The map file of a table: its plant, which columns are its signals, their units, what to read."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import UserError
from hydro_twin.recording.signals import load_yaml, number

UNITS = {   # unit of a column -> its SI unit, and how much of it it is
    '1': ('1', 1.0), '%': ('1', 1e-2), 'percent': ('1', 1e-2),
    's': ('s', 1.0), 'ms': ('s', 1e-3), 'us': ('s', 1e-6), 'ns': ('s', 1e-9),
    'm': ('m', 1.0), 'cm': ('m', 1e-2), 'mm': ('m', 1e-3), 'um': ('m', 1e-6),
    'm/s': ('m/s', 1.0), 'mm/s': ('m/s', 1e-3),
    'rad': ('rad', 1.0), 'deg': ('rad', math.pi / 180.0),
    'rad/s': ('rad/s', 1.0), 'deg/s': ('rad/s', math.pi / 180.0), 'rpm': ('rad/s', math.pi / 30.0),
    'N': ('N', 1.0), 'kN': ('N', 1e3), 'N m': ('N m', 1.0), 'kN m': ('N m', 1e3),
    'Pa': ('Pa', 1.0), 'kPa': ('Pa', 1e3), 'MPa': ('Pa', 1e6), 'bar': ('Pa', 1e5),
    'V': ('V', 1.0), 'mV': ('V', 1e-3), 'A': ('A', 1.0), 'mA': ('A', 1e-3),
}
SLOWEST, FASTEST = 1e-9, 1e9    # sample rates [Hz]: stamps are whole ns, and hold 2e9 s


@dataclass(frozen=True)
class Column:
    """A signal in a table: scale * (product of the columns) in the unit, + offset in its SI unit.

    Attributes:
        unit: one of UNITS, or None for the unit of the plant's signal.
    """

    columns: tuple[str, ...]
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0

    @property
    def si_unit(self) -> str | None:
        """The SI unit that the values are converted to, None where no unit is given."""
        return None if self.unit is None else UNITS[self.unit][0]

    @property
    def factor(self) -> float:
        """What the product of the columns is multiplied by."""
        return self.scale * (1.0 if self.unit is None else UNITS[self.unit][1])

    def product(self, table: Mapping[str, FloatArray]) -> FloatArray:
        """Multiply the columns."""
        value = table[self.columns[0]]
        for name in self.columns[1:]:
            value = value * table[name]
        return value

    def take(self, table: Mapping[str, FloatArray]) -> FloatArray:
        """Compute the signal."""
        return np.asarray(self.factor * self.product(table) + self.offset)


@dataclass(frozen=True)
class TableMap:
    """How to read a table.

    Attributes:
        plant: whose signals these are.
        signals: name -> where it is in the table.
        time: the column with the time, or
        sample_time: the distance of the rows [s].
        series: a column that changes where a new series begins.
        rows: the first and the last row to read, counted from 1, after the names; None: the last
            of the table.
        time_range: the times to read, both included [s].
        origin: where the data comes from; the bag will say so.
        decimal: what separates the whole part of a number in a text file, '.' or ','.
        header: whether a text file has a line of names; else its columns are 1, 2, 3, ...
    """

    plant: str
    signals: Mapping[str, Column]
    time: Column | None = None
    sample_time: float | None = None
    series: str | None = None
    rows: tuple[int, int | None] = (1, None)
    time_range: tuple[float, float] = (-math.inf, math.inf)
    origin: str = ''
    decimal: str = '.'
    header: bool = True


KEYS = ('plant', 'signals', 'time', 'sample_rate', 'series', 'rows', 'time_range', 'origin',
        'decimal', 'header')


def load_map(path: Path) -> TableMap:
    """Load a map file; config/measured holds examples.

    Raises:
        UserError: it cannot be read, or it lacks something, or something in it is unknown.
    """
    document = load_yaml(path)
    if not isinstance(document, dict) or not isinstance(document.get('signals'), dict):
        raise UserError(f"{path} is not a map file: it needs 'plant', 'signals', and 'time' or "
                        "'sample_rate'")
    if unknown := sorted(map(str, document.keys() - set(KEYS))):
        raise UserError(f'{path}: unknown {", ".join(unknown)}; a map file has {", ".join(KEYS)}')
    if ('time' in document) == ('sample_rate' in document):
        raise UserError(f"{path} must have either 'time', a column, or 'sample_rate' [Hz]")
    rate = None
    if 'sample_rate' in document:
        rate = number(document['sample_rate'], f'{path}: sample_rate')
        if rate <= 0.0:
            raise UserError(f'{path}: sample_rate must be above zero')
        if not SLOWEST <= rate <= FASTEST:
            raise UserError(f'{path}: sample_rate {rate:g} Hz is not between {SLOWEST:g} and '
                            f'{FASTEST:g} Hz')
    time = _column(document['time'], f'{path}: time') if 'time' in document else None
    if time is not None and time.si_unit not in (None, 's'):
        raise UserError(f'{path}: time: {time.unit} is not a unit of time; there are '
                        f'{", ".join(unit for unit, (si, _) in UNITS.items() if si == "s")}')
    decimal = document.get('decimal', '.')
    if decimal not in ('.', ','):
        raise UserError(f"{path}: decimal must be '.' or ',', not {decimal!r}")
    header = document.get('header', True)
    if not isinstance(header, bool):
        raise UserError(f'{path}: header must be true or false, not {header!r}')
    signals = {str(name): _column(given, f'{path}: signal {name}')
               for name, given in document['signals'].items()}
    return TableMap(
        plant=str(document.get('plant') or ''), signals=signals, time=time,
        sample_time=1.0 / rate if rate else None,
        series=str(document['series']) if 'series' in document else None,
        rows=_rows(document.get('rows', [1, None]), f'{path}: rows'),
        time_range=_time_range(document.get('time_range', [None, None]), f'{path}: time_range'),
        origin=' '.join(str(document.get('origin') or '').split()), decimal=decimal,
        header=header)


def _column(given: Any, what: str) -> Column:
    """Read one entry: a column's name, or column or product, unit, scale, offset."""
    if isinstance(given, str | int):
        given = {'column': given}
    if not isinstance(given, dict) or ('column' in given) == ('product' in given):
        raise UserError(f"{what} needs either 'column', a name, or 'product', a list of names")
    if unknown := sorted(map(str, given.keys() - {'column', 'product', 'unit', 'scale',
                                                  'offset'})):
        raise UserError(f'{what}: unknown {", ".join(unknown)}; there are column or product, '
                        'unit, scale, offset')
    names = given['product'] if 'product' in given else [given['column']]
    if not isinstance(names, list) or not names:
        raise UserError(f"{what}: 'product' must be a list of columns")
    unit = str(given['unit']) if 'unit' in given else None
    if unit is not None and unit not in UNITS:
        raise UserError(f'{what}: unknown unit {unit!r}; there are {", ".join(UNITS)}')
    return Column(tuple(map(str, names)), unit,
                  number(given.get('scale', 1.0), f'{what}: scale'),
                  number(given.get('offset', 0.0), f'{what}: offset'))


def _rows(given: Any, what: str) -> tuple[int, int | None]:
    """Read [first, last]; null stands for an end of the table."""
    if isinstance(given, list) and len(given) == 2:
        first, last = 1 if given[0] is None else given[0], given[1]
        if type(first) is int and first >= 1 and (
                last is None or (type(last) is int and last >= first)):
            return first, last
    raise UserError(f'{what} must be [first, last], row numbers from 1 up, or null for the end of '
                    f'the table, not {given!r}')


def _time_range(given: Any, what: str) -> tuple[float, float]:
    """Read [begin, end] in seconds; null stands for an end of the table."""
    if not isinstance(given, list) or len(given) != 2:
        raise UserError(f'{what} must be [begin, end] in seconds, or null for an end of the '
                        f'table, not {given!r}')
    begin = -math.inf if given[0] is None else number(given[0], what)
    end = math.inf if given[1] is None else number(given[1], what)
    if not begin < end:
        raise UserError(f'{what} ends at {end:g} s, which is not after its start, {begin:g} s')
    return begin, end


def units_in_bag(table_map: TableMap, plant_units: Mapping[str, str], source: str,
                 ) -> dict[str, str]:
    """Check the units of the signals against the plant's.

    Args:
        table_map: the map.
        plant_units: signal -> its SI unit; '1' takes any (a command in V, in A or relative).
        source: the map file, for messages.

    Returns:
        Signal -> the SI unit that its values have in the bag.

    Raises:
        UserError: a unit measures something else than the plant's.
    """
    units = {}
    for name, column in table_map.signals.items():
        plant_unit, si_unit = plant_units[name], column.si_unit
        if si_unit is not None and plant_unit not in ('1', si_unit):
            fitting = ', '.join(unit for unit, (si, _) in UNITS.items() if si == plant_unit)
            raise UserError(f'{source}: signal {name}: {column.unit} cannot be converted to '
                            f'{plant_unit}; units for it are {fitting}')
        units[name] = plant_unit if si_unit is None else si_unit
    return units
