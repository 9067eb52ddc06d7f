"""Turns tables (CSV, MAT) into series, by a map file that names their columns and units."""
from __future__ import annotations

from collections.abc import Mapping
import csv
from dataclasses import dataclass
import gzip
from itertools import pairwise
import math
from pathlib import Path
from typing import Any
import warnings

import numpy as np

from hydro_twin.errors import BagError, UserError
from hydro_twin.recording.series import FloatArray, Series
from hydro_twin.recording.signals import load_yaml, number

UNITS = {   # unit of a column -> how much of the SI unit it is
    '1': 1.0, '%': 1e-2, 'percent': 1e-2,
    's': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9,
    'm': 1.0, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6, 'm/s': 1.0, 'mm/s': 1e-3,
    'rad': 1.0, 'deg': math.pi / 180.0, 'rad/s': 1.0, 'deg/s': math.pi / 180.0,
    'rpm': math.pi / 30.0,
    'N': 1.0, 'kN': 1e3, 'N m': 1.0, 'kN m': 1e3,
    'Pa': 1.0, 'kPa': 1e3, 'MPa': 1e6, 'bar': 1e5,
    'V': 1.0, 'mV': 1e-3, 'A': 1.0, 'mA': 1e-3,
}
START = 1_000_000_000   # stamp of the first sample [ns]: in ROS a stamp of zero means none
PAUSE = 10_000_000_000   # between two series [ns]
SUFFIXES = ('.csv', '.csv.gz', '.mat')


@dataclass(frozen=True)
class Column:
    """A signal in a table: scale * (product of the columns) + offset, after the unit."""

    columns: tuple[str, ...]
    scale: float = 1.0
    offset: float = 0.0

    def take(self, table: Mapping[str, FloatArray]) -> FloatArray:
        """Compute the signal."""
        value = table[self.columns[0]]
        for name in self.columns[1:]:
            value = value * table[name]
        return np.asarray(self.scale * value + self.offset)


@dataclass(frozen=True)
class TableMap:
    """How to read a table.

    Attributes:
        plant: whose signals these are.
        signals: name -> where it is in the table.
        time: the column with the time [s], or
        sample_time: the distance of the rows [s].
        series: a column that changes where a new series begins.
        origin: where the data comes from; the bag will say so.
    """

    plant: str
    signals: Mapping[str, Column]
    time: Column | None = None
    sample_time: float | None = None
    series: str | None = None
    origin: str = ''


def load_map(path: Path) -> TableMap:
    """Load a map file; config/measured holds examples.

    Raises:
        UserError: it cannot be read, or it lacks something, or something in it is unknown.
    """
    document = load_yaml(path)
    if not isinstance(document, dict) or not isinstance(document.get('signals'), dict):
        raise UserError(f"{path} is not a map file: it needs 'plant', 'signals', and 'time' or "
                        "'sample_rate'")
    known = ('plant', 'signals', 'time', 'sample_rate', 'series', 'origin')
    if unknown := sorted(map(str, document.keys() - set(known))):
        raise UserError(f'{path}: unknown {", ".join(unknown)}; a map file has '
                        f'{", ".join(known)}')
    if ('time' in document) == ('sample_rate' in document):
        raise UserError(f"{path} must have either 'time', a column, or 'sample_rate' [Hz]")
    rate = None
    if 'sample_rate' in document:
        rate = number(document['sample_rate'], f'{path}: sample_rate')
        if rate <= 0.0:
            raise UserError(f'{path}: sample_rate must be above zero')
    signals = {str(name): _column(given, f'{path}: signal {name}')
               for name, given in document['signals'].items()}
    return TableMap(
        plant=str(document.get('plant', '')), signals=signals,
        time=_column(document['time'], f'{path}: time') if 'time' in document else None,
        sample_time=1.0 / rate if rate else None,
        series=str(document['series']) if 'series' in document else None,
        origin=' '.join(str(document.get('origin', '')).split()))


def _column(given: Any, what: str) -> Column:
    """Read one entry: a column's name, or column or product, unit, scale, offset."""
    if isinstance(given, str):
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
    unit = str(given.get('unit', '1'))
    if unit not in UNITS:
        raise UserError(f'{what}: unknown unit {unit!r}; there are {", ".join(UNITS)}')
    return Column(tuple(map(str, names)),
                  number(given.get('scale', 1.0), f'{what}: scale') * UNITS[unit],
                  number(given.get('offset', 0.0), f'{what}: offset'))


def read_table(path: Path, table_map: TableMap) -> list[Series]:
    """Read a table as series, in the rate of the table.

    Raises:
        BagError: the table cannot be read, lacks a column, or holds what is not a number.
    """
    entries = [*table_map.signals.values(), *([table_map.time] if table_map.time else [])]
    wanted = {name for entry in entries for name in entry.columns}
    table = _load(path, wanted | ({table_map.series} if table_map.series else set()))
    rows = max(map(len, table.values()))
    if any(len(column) not in (1, rows) for column in table.values()):
        lengths = ', '.join(f'{name} {len(column)}' for name, column in table.items())
        raise BagError(f'{path}: columns of different lengths: {lengths}')
    for name, column in table.items():
        if not np.isfinite(column).all():
            raise BagError(f'{path}: column {name} is not a finite number in row '
                           f'{np.argmin(np.isfinite(column)) + 1}')
    cuts = [0, rows]
    if table_map.series:
        cuts[1:1] = (np.flatnonzero(np.diff(table[table_map.series])) + 1).tolist()
    time = (table_map.time.take(table) if table_map.time
            else np.arange(rows, dtype=np.float64) * (table_map.sample_time or 1.0))
    series: list[Series] = []
    for begin, end in pairwise(cuts):
        columns = {name: np.broadcast_to(entry.take(table), rows)[begin:end]
                   for name, entry in table_map.signals.items()}
        start = START if not series else series[-1].part(len(series[-1]), 0).start + PAUSE
        series += _stretches(path, time[begin:end], columns, start, begin)
    return series


def _stretches(path: Path, time: FloatArray, columns: Mapping[str, FloatArray], start: int,
               row: int) -> list[Series]:
    """Cut rows at pauses; within a stretch they are as far apart as they typically are."""
    steps = np.diff(time)
    if len(steps) == 0 or (steps <= 0.0).any():
        at = row + 2 + (int(np.argmax(steps <= 0.0)) if len(steps) else 0)
        raise BagError(f'{path}: the time does not increase at row {at}')
    step = float(np.median(steps))
    uneven = np.abs(steps - step) > 0.5 * step
    ends = [0, *(np.flatnonzero(uneven) + 1).tolist(), len(time)]
    found = []
    for begin, end in pairwise(ends):
        count = end - begin
        sample_time = (time[end - 1] - time[begin]) / (count - 1) if count > 1 else step
        found.append(Series({name: column[begin:end] for name, column in columns.items()},
                            round(sample_time, 9),
                            start + round((time[begin] - time[0]) * 1e9), str(path)))
    return found


def _load(path: Path, wanted: set[str]) -> dict[str, FloatArray]:
    """Load the columns wanted of a table."""
    if not path.is_file():
        raise BagError(f'{path}: no such table')
    if not path.name.lower().endswith(SUFFIXES):
        raise BagError(f'{path}: a table is {", ".join(SUFFIXES)}')
    return _load_mat(path, wanted) if path.suffix.lower() == '.mat' else _load_csv(path, wanted)


def _missing(path: Path, wanted: set[str], there: list[str]) -> None:
    """Say which columns are not there."""
    if absent := sorted(wanted - set(there)):
        raise BagError(f'{path} has no column {", ".join(absent)}; it has {", ".join(there)}')


def _load_csv(path: Path, wanted: set[str]) -> dict[str, FloatArray]:
    """Load columns of a CSV file with one line of names; between them ',', ';' or a tab."""
    try:
        with (gzip.open(path, 'rt', encoding='utf-8-sig') if path.suffix.lower() == '.gz'
              else path.open(encoding='utf-8-sig')) as file:
            line = file.readline()
            delimiter = max(',;\t', key=line.count)
            header = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
            names = [name.strip() for name in next(header, [])]
            _missing(path, wanted, names)
            order = sorted(wanted)
            with warnings.catch_warnings(action='ignore'):   # 'no data' is said below
                data = np.loadtxt(file, delimiter=delimiter, comments=None, quotechar='"',
                                  ndmin=2, usecols=[names.index(name) for name in order])
    except (OSError, EOFError, UnicodeDecodeError, ValueError) as error:
        raise BagError(f'{path} cannot be read: {error}') from None
    if len(data) == 0:
        raise BagError(f'{path} has no rows')
    return {name: data[:, k].copy() for k, name in enumerate(order)}


def _load_mat(path: Path, wanted: set[str]) -> dict[str, FloatArray]:
    """Load variables of a MAT file; a single number counts as a column of it."""
    from scipy.io import loadmat, whosmat

    try:
        _missing(path, wanted, [name for name, _, _ in whosmat(path)])
        content = loadmat(path, variable_names=list(wanted))
        columns = {name: np.asarray(content[name], np.float64) for name in wanted}
    except NotImplementedError:
        raise BagError(f"{path} is a MAT file of version 7.3: save it with '-v7'") from None
    except BagError:
        raise
    except Exception as error:   # scipy lets out whatever a damaged byte causes
        raise BagError(f'{path} cannot be read as a MAT file: {error}') from None
    for name, column in columns.items():
        if column.size == 0 or column.size != max(column.shape, default=1):
            shape = ' x '.join(map(str, column.shape))
            raise BagError(f'{path}: {name} is {shape}, not a column')
    return {name: column.ravel() for name, column in columns.items()}
