"""The flow characteristic of the turbine valve: steam flow against opening, and its end, d_1."""
from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.integrate import trapezoid
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.share import share_folder

RIGHT = 'expected a header and then rows of opening, flow'


@dataclass(frozen=True)
class FlowCharacteristic:
    """Flow against opening, both in units of nominal, interpolated monotonically (PCHIP)."""

    opening: FloatArray
    flow: FloatArray

    @property
    def d_1(self) -> float:
        """The opening at which the curve, and with it the valve's travel, ends [1]."""
        return float(self.opening[-1])

    def __call__(self, opening: float | FloatArray) -> FloatArray:
        """Interpolate the flow [1]; outside the curve it goes on as at its end."""
        inside = np.clip(opening, self.opening[0], self.opening[-1])
        slope = (self.flow[-1] - self.flow[-2]) / (self.opening[-1] - self.opening[-2])
        return np.asarray(self._curve(inside) + slope * np.maximum(opening - inside, 0))

    @cached_property
    def _curve(self) -> PchipInterpolator:
        return PchipInterpolator(self.opening, self.flow)

    def inverse(self, flow: float) -> float:
        """Return the opening that gives a flow within the curve [1]."""
        return float(brentq(lambda opening: float(self(opening)) - flow, 0, self.d_1))


def read_characteristic(path: Path) -> FlowCharacteristic:
    """Read a flow characteristic from a CSV file of two columns, opening and flow.

    The header names them in that order; both are in units of nominal, or in per cent where the
    header says so with % or percent.

    Raises:
        DataError: the file is not such a table, a column does not rise, the two are swapped, or
            the curve ends below 1, so that it does not show the limit.
    """
    header, table = _read_table(path)
    names = [name.strip().lower() for name in header]
    if names[0].startswith('flow') and names[1].startswith('opening'):
        raise DataError(f'{path}: the columns are swapped, {RIGHT}')
    if not (names[0].startswith('opening') and names[1].startswith('flow')):
        raise DataError(f'{path}: has the columns {", ".join(header)}; {RIGHT}')
    scale = [0.01 if '%' in name or 'percent' in name else 1.0 for name in names]
    opening, flow = (table * scale).T
    for name, column in (('opening', opening), ('flow', flow)):
        fall = np.flatnonzero(np.diff(column) <= 0)
        if len(fall):
            raise DataError(f'{path}: {name} does not rise from row {fall[0] + 1} to '
                            f'{fall[0] + 2} ({column[fall[0]]:g}, {column[fall[0] + 1]:g}); '
                            'both must rise throughout')
    for name, column in (('opening', opening), ('flow', flow)):
        if column[-1] < 1:
            raise DataError(f'{path}: {name} ends at {column[-1]:g}, below 1; the curve must go '
                            'on to the end of the travel (mark per cent with % in the header)')
        if column[-1] > 2:
            raise DataError(f'{path}: {name} ends at {column[-1]:g} times nominal; mark per cent '
                            'with % in the header')
    # A turbine valve saturates: its flow lies above the straight line from end to end.
    line = flow[0] + (opening - opening[0]) * np.ptp(flow) / np.ptp(opening)
    if trapezoid(flow - line, opening) < -1e-3:
        raise DataError(f'{path}: the flow of a turbine valve saturates with the opening, here '
                        f'the first column saturates with the second: swapped? {RIGHT}')
    return FlowCharacteristic(opening, flow)


def default_characteristic() -> FlowCharacteristic:
    """Read the curve that comes with the package: typical of a turbine valve, of no plant."""
    return read_characteristic(share_folder() / 'config' / 'flow_characteristic.csv')


def _read_table(path: Path) -> tuple[list[str], FloatArray]:
    """Read a header and rows of two numbers."""
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            header, *rows = [row for row in csv.reader(file) if row]
        table = np.array([[float(cell) for cell in row] for row in rows])
    except FileNotFoundError:
        raise DataError(f'{path}: there is no such file') from None
    except (ValueError, UnicodeDecodeError, csv.Error):
        raise DataError(f'{path}: is not a table of numbers; {RIGHT}') from None
    if len(header) != 2 or table.ndim != 2 or table.shape[1] != 2:
        raise DataError(f'{path}: has {len(header)} columns; {RIGHT}')
    if len(table) < 3:
        raise DataError(f'{path}: has {len(table)} points; a curve needs at least 3')
    if not np.all(np.isfinite(table)):
        raise DataError(f'{path}: has a value that is not finite; {RIGHT}')
    return header, table
