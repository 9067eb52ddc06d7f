"""Rows as vectors of the processor, against numpy."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.compiled import compiled
from hydro_twin.predictors.rows import add, clear, combine, copy, in_rows, LINE, put, WIDTH


@compiled
def work(out, rows):
    """Do each operation on a single row once."""
    clear(out, 0)
    put(out, 1, 3.0, rows, 2)
    add(out, 2, -2.0, rows, 0)


@compiled
def copied(out, rows, count):
    """Copy rows."""
    copy(out, rows, count)


@compiled
def combined(out, fresh, factors, rows):
    """Add what a matrix makes of rows 2 and 3, and a vector of one group of rows after another."""
    combine(out, 2, fresh, factors, 1, 3, 1, rows, 2, 0, 1, 2)
    combine(out, 2, False, factors, 0, 0, 1, rows, 0, 3, 1, 3)
    combine(out, 1, False, factors, 0, 0, 1, rows, 0, 0, 1, 0)


COLUMNS = pytest.mark.parametrize('columns', [1, WIDTH, WIDTH + 1, 3 * WIDTH - 2])


@COLUMNS
def test_multiples_of_rows_are_those_of_numpy(columns):
    rng = np.random.default_rng(columns)
    out, rows = (rng.standard_normal((count, columns)) for count in (4, 3))
    done = in_rows(out)
    work(done, in_rows(rows))
    check(done, np.stack([np.zeros(columns), 3.0 * rows[2], out[2] - 2.0 * rows[0], out[3]]))


@COLUMNS
def test_rows_are_copied(columns):
    rng = np.random.default_rng(columns)
    out, rows = (rng.standard_normal((count, columns)) for count in (4, 3))
    done = in_rows(out)
    copied(done, in_rows(rows), 2)
    check(done, np.stack([*rows[:2], *out[2:]]))


@COLUMNS
@pytest.mark.parametrize('fresh', [False, True])
def test_sums_of_rows_are_those_of_numpy(columns, fresh):
    rng = np.random.default_rng(columns)
    out, rows, factors = (rng.standard_normal(shape) for shape in
                          ((3, columns), (6, columns), (2, 3)))
    done = in_rows(out)
    combined(done, fresh, factors, in_rows(rows))
    vector = factors[0]
    check(done, np.stack([*((0.0 if fresh else out[:2]) + factors[:, 1:] @ rows[2:4]
                            + np.stack([vector @ rows[:3], vector @ rows[3:]])), out[2]]))


def check(done, expected):
    """Compare rows with numbers, beyond which there are zeros."""
    columns = expected.shape[1]
    flat = done.reshape(len(expected), -1)
    np.testing.assert_allclose(flat[:, :columns], expected, rtol=1e-14, atol=1e-14)
    assert not flat[:, columns:].any()


@pytest.mark.parametrize('columns', [1, WIDTH + 1])
def test_rows_begin_on_lines_of_the_cache(columns):
    for _ in range(20):
        assert in_rows(np.ones((3, columns))).ctypes.data % LINE == 0
