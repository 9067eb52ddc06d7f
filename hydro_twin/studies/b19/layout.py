"""How figures are written on the page on [B19]: numbers, p-values, tables."""
from __future__ import annotations

from collections.abc import Iterable, Sequence
import math

import numpy as np

from hydro_twin.studies.b19.study import five_numbers


def median(errors: Iterable[float | None]) -> float:
    """Take the median; None stands for a run that diverged."""
    return float(five_numbers(array(errors))[2])


def array(errors: Iterable[float | None]) -> np.ndarray:
    """Take the errors; None stands for a run that diverged."""
    return np.array([math.inf if error is None else error for error in errors])


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out a Markdown table."""
    lines = [[f' {cell} ' if cell else ' ' for cell in line] for line in (head, *rows)]
    lines.insert(1, ['---'] * len(head))
    return '\n'.join(f'|{"|".join(line)}|' for line in lines)


def number(value: float, digits: int = 4) -> str:
    """Write an error to a number of significant digits."""
    if not math.isfinite(value):
        return 'diverged'
    return f'{value:.0f}' if value >= 10 ** (digits - 1) else f'{value:#.{digits}g}'


def p_value(value: float) -> str:
    """Write a p-value."""
    return f'{value:.2f}' if value >= 0.01 else small(value, 0)


def small(value: float, decimals: int) -> str:
    """Write a small number with an exponent."""
    return f'{value:.{decimals}e}'.replace('e-0', 'e-').replace('0e+00', '0')
