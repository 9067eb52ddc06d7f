"""Rows as vectors of the processor, against numpy."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.compiled import compiled
from hydro_twin.predictors.rows import add, clear, in_rows, LINE, put, weigh, WIDTH


@compiled
def work(out, rows, factors):
    """Do each operation once."""
    clear(out, 0)
    put(out, 1, 3.0, rows, 2)
    add(out, 2, -2.0, rows, 0)
    weigh(out, 3, factors, rows, 1, 3)
    weigh(out, 4, factors, rows, 0, 0)


@pytest.mark.parametrize('columns', [1, WIDTH, WIDTH + 1, 3 * WIDTH - 2])
def test_sums_of_rows_are_those_of_numpy(columns):
    rng = np.random.default_rng(columns)
    out, rows, factors = (rng.standard_normal(shape) for shape in
                          ((5, columns), (4, columns), (3,)))
    done = in_rows(out)
    work(done, in_rows(rows), factors)
    expected = np.stack([np.zeros(columns), 3.0 * rows[2], out[2] - 2.0 * rows[0],
                         out[3] + factors @ rows[1:], out[4]])
    flat = done.reshape(5, -1)
    np.testing.assert_allclose(flat[:, :columns], expected, rtol=1e-14, atol=1e-14)
    assert not flat[:, columns:].any()


@pytest.mark.parametrize('columns', [1, WIDTH + 1])
def test_rows_begin_on_lines_of_the_cache(columns):
    for _ in range(20):
        assert in_rows(np.ones((3, columns))).ctypes.data % LINE == 0
