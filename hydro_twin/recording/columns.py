"""Columns of tables: text (CSV, by blanks), MAT files, NPZ files of numpy."""
from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import csv
import gzip
from itertools import chain, islice
import logging
from pathlib import Path
import re
import zlib

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import BagError
from hydro_twin.recording.table_map import TableMap

log = logging.getLogger(__name__)

COLUMN_OF = re.compile(r'(.+)\[(\d+)\]')
TEXT = ('.csv', '.tsv', '.txt', '.dat')
ARRAYS = ('.mat', '.npz')
SUFFIXES = (*TEXT, *(f'{suffix}.gz' for suffix in TEXT), *ARRAYS)


def load_columns(path: Path, wanted: set[str], table_map: TableMap) -> dict[str, FloatArray]:
    """Load columns of a table, the rows that its map asks for.

    Raises:
        BagError: the table cannot be read, lacks a column, or holds what is not a number.
    """
    if not path.is_file():
        raise BagError(f'{path}: no such table')
    if not path.name.lower().endswith(SUFFIXES):
        raise BagError(f'{path}: a table is {", ".join(SUFFIXES)}')
    if path.suffix.lower() in ARRAYS:
        return _load_arrays(path, wanted, table_map.rows)
    return _load_text(path, wanted, table_map)


def _check_names(path: Path, wanted: set[str], there: list[str], header: bool = False) -> None:
    """Say which columns are not there, or are there twice; `header`: they are a line of a text."""
    if absent := sorted(wanted - set(there)):
        said = f'{path} has no column {", ".join(absent)}; it has {", ".join(there)}'
        if header and there and all(map(_is_number, there)):
            said += '; for a table without a line of names give header: false in the map'
        raise BagError(said)
    if twice := sorted(name for name in wanted if there.count(name) > 1):
        raise BagError(f'{path} has several columns named {", ".join(twice)}: which one is meant?')


def _is_number(text: str) -> bool:
    """Whether a text can be read as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _too_short(path: Path, rows: tuple[int, int | None]) -> BagError:
    """Make the error for a table that does not reach the rows asked for."""
    return BagError(f'{path} has no rows' if rows[0] == 1 else f'{path} has no row {rows[0]}')


@contextmanager
def _opened(path: Path, table_map: TableMap
            ) -> Iterator[tuple[Iterator[str], list[str], str | None]]:
    """Open a text file; yield its rows, the names of its columns, and what separates them.

    That is ',', ';' or a tab, whichever is in the header or, without one, in the first row that is
    used; None stands for blanks. A line of numbers with decimal commas does not show whether
    commas separate them, too: they do not.
    """
    header = table_map.header
    separators = ',;\t' if header or table_map.decimal == '.' else ';\t'
    with (gzip.open(path, 'rt', encoding='utf-8-sig') if path.suffix.lower() == '.gz'
          else path.open(encoding='utf-8-sig')) as file:
        rows: Iterator[str] = filter(str.strip, file)
        first = [next(file, '')] if header else list(islice(rows, table_map.rows[0]))
        line = first[-1] if first else ''
        delimiter = max(separators, key=line.count)
        separator = delimiter if delimiter in line else None
        names = _cells(line.lstrip('#') if header else line, separator)
        if not header:
            names, rows = [str(k + 1) for k in range(len(names))], chain(first, rows)
        yield rows, names, separator


def _cells(line: str, separator: str | None) -> list[str]:
    """Divide a line of a text file."""
    if separator is None:
        return line.split()
    (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in cells]


def _load_text(path: Path, wanted: set[str], table_map: TableMap) -> dict[str, FloatArray]:
    """Load columns of a text file."""
    order, rows, decimal = sorted(wanted), table_map.rows, table_map.decimal
    try:
        with _opened(path, table_map) as (file, names, delimiter):
            _check_names(path, wanted, names, table_map.header)
            lines = list(islice(file, rows[0] - 1, rows[1]))
            there = len(_cells(lines[-1], delimiter)) if lines else 0
            if len(lines) > 1 and there < len(names) and not any(file):
                log.warning('%s: the last row is cut short (%d of %d columns), and left out',
                            path, there, len(names))
                lines.pop()
    except UnicodeDecodeError as error:
        raise BagError(f'{path} cannot be read: save it in UTF-8 ({error})') from None
    except (OSError, EOFError, zlib.error) as error:
        raise BagError(f'{path} cannot be read: {error}') from None
    if decimal == delimiter:
        raise BagError(f'{path}: a comma separates its columns, so it cannot be in its numbers')
    if decimal != '.':
        lines = [line.replace(decimal, '.') for line in lines]
    if not lines:
        raise _too_short(path, rows)
    used = [names.index(name) for name in order]
    try:
        data = np.loadtxt(lines, delimiter=delimiter, comments=None, quotechar='"', ndmin=2,
                          usecols=used)
    except ValueError as error:
        said = _bad_cell(lines, delimiter, dict(zip(used, order, strict=True)), rows[0])
        raise BagError(f'{path}: {said or f"cannot be read: {error}"}') from None
    return {name: data[:, k].copy() for k, name in enumerate(order)}


def _bad_cell(lines: list[str], delimiter: str | None, names: Mapping[int, str], first: int
              ) -> str:
    """Say where the first cell is that is no number; '' if none is found."""
    for row, cells in enumerate((_cells(line, delimiter) for line in lines), start=first):
        for index, name in names.items():
            if index >= len(cells):
                return f'row {row} has no column {name}: it has {len(cells)} columns only'
            if not _is_number(cells[index]):
                said = repr(cells[index]) if cells[index].strip() else 'the cell is empty'
                if delimiter != ',' and ',' in said:
                    said += "; for a decimal comma give decimal: ',' in the map"
                return f'column {name} is not a finite number in row {row}: {said}'
    return ''


def _load_arrays(path: Path, wanted: set[str], rows: tuple[int, int | None]
                 ) -> dict[str, FloatArray]:
    """Load arrays of a MAT or NPZ file; `q[2]` is the third column of an array q of several."""
    places = {name: COLUMN_OF.fullmatch(name) for name in wanted}
    owners = {name: place[1] if place else name for name, place in places.items()}
    kind, read = ('MAT', _read_mat) if path.suffix.lower() == '.mat' else ('NPZ', _read_npz)
    try:
        arrays = read(path, set(owners.values()))
        columns = {name: _column_of(path, name, arrays[owners[name]], int(place[2])) if place
                   else arrays[name] for name, place in places.items()}
    except BagError:
        raise
    except IndexError as error:
        raise BagError(f'{path}: {error}') from None
    except Exception as error:   # whatever a damaged byte causes, or an array of objects
        raise BagError(f'{path} cannot be read as a {kind} file: {error}') from None
    return _as_columns(path, columns, rows)


def _column_of(path: Path, name: str, array: FloatArray, index: int) -> FloatArray:
    """Take a column of an array; of one that lies on its side it would be a single number."""
    if array.ndim == 2 and len(array) == 1 < array.shape[1]:
        raise BagError(f'{path}: {name}: an array of 1 x {array.shape[1]} has one row; '
                       'transpose it')
    return array[:, index]


def _real(path: Path, name: str, array: np.ndarray) -> FloatArray:
    """Take an array as numbers; complex ones would lose their imaginary part."""
    if np.iscomplexobj(array):
        raise BagError(f'{path}: {name} is complex; save its real or its imaginary part')
    return np.asarray(array, np.float64)


def _read_mat(path: Path, wanted: set[str]) -> dict[str, FloatArray]:
    """Read variables of a MAT file."""
    from scipy.io import loadmat

    try:
        content = loadmat(path, variable_names=list(wanted))
        if not wanted <= content.keys():
            content = loadmat(path)     # whosmat cannot list them beside an object of MATLAB's
    except NotImplementedError:
        raise BagError(f"{path} is a MAT file of version 7.3: save it with '-v7'") from None
    _check_names(path, wanted, [name for name in content if not name.startswith('__')])
    return {name: _real(path, name, content[name]) for name in wanted}


def _read_npz(path: Path, wanted: set[str]) -> dict[str, FloatArray]:
    """Read arrays of an NPZ file."""
    with np.load(path) as content:
        _check_names(path, wanted, list(content))
        return {name: _real(path, name, content[name]) for name in wanted}


def _as_columns(path: Path, variables: Mapping[str, FloatArray], rows: tuple[int, int | None],
                ) -> dict[str, FloatArray]:
    """Take the rows of variables; a single number counts as a column of it."""
    for name, variable in variables.items():
        if variable.size == 0 or variable.size != max(variable.shape, default=1):
            shape = ' x '.join(map(str, variable.shape))
            raise BagError(f'{path}: {name} is {shape}, not a column')
    if max(variable.size for variable in variables.values()) < rows[0]:
        raise _too_short(path, rows)
    return {name: one.ravel() if one.size == 1 else one.ravel()[rows[0] - 1:rows[1]]
            for name, one in variables.items()}
