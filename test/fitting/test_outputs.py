"""Output and sensors of several parts as the rows of one fit."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.fitting.elimination import eliminate
from hydro_twin.fitting.outputs import Layout, Stack
from hydro_twin.fitting.parts import Part

RNG = np.random.default_rng(3)


def part(samples: int) -> Part:
    """Make a part with a sensor that is not there everywhere."""
    sensor = RNG.standard_normal(samples)
    sensor[RNG.uniform(size=samples) < 0.3] = np.nan
    return Part(RNG.standard_normal((samples, 2)), RNG.standard_normal(samples),
                sensors={'p_L': sensor})


@pytest.mark.parametrize('sensors', [[], ['p_L']])
def test_the_layout_of_some_parts_is_that_of_these_alone(sensors):
    parts = [part(n) for n in (30, 25, 41, 25)]
    stacks = [Stack.of(one, sensors, 8) for one in parts]
    found = Layout.of(parts, stacks).at(np.array([1, 2]))
    alone = Layout.of(parts[1:3], stacks[1:3])
    for name in ('inputs', 'measured', 'edges', 'rows', 'of_parts'):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))


def test_rows_are_what_was_measured_first_samples_first():
    """Each part by itself, output before sensor, gaps left out, each times its scale."""
    parts = [part(30), part(25)]
    layout = Layout.of(parts, [Stack.of(one, ['p_L'], 8) for one in parts])
    picked = layout.pick(layout.measured, np.array([2.0, 3.0]))
    expected = []
    for one in parts:
        for some in (slice(None, 8), slice(8, None)):
            sensor = one.sensors['p_L'][some]
            expected += [2.0 * one.measured[some], 3.0 * sensor[np.isfinite(sensor)]]
    np.testing.assert_array_equal(picked, np.concatenate(expected))
    (_, scored, end), second = layout.of_parts
    assert end == second[0] == sum(map(len, expected[:4]))
    assert scored == sum(map(len, expected[:2]))


def test_initial_states_are_eliminated_part_by_part():
    """As weighted least squares [Golub and Pereyra 1973] of each part by itself."""
    spans = np.array([[0, 10, 60], [60, 70, 90], [90, 100, 190]])
    by_state, residual = RNG.standard_normal((190, 2)), RNG.standard_normal(190)
    others = RNG.standard_normal((190, 3))
    left = eliminate(residual, by_state, np.ones(2), spans, others, np.array([1.0, 4.0, 2.0]))
    for k, (begin, scored, end) in enumerate(spans):
        root = np.where(np.arange(begin, end) < scored, [1.0, 2.0, np.sqrt(2.0)][k], 1.0)[:, None]
        columns = np.column_stack([residual, others])[begin:end]
        change = np.linalg.lstsq(root * by_state[begin:end], root * columns)[0]
        rest = (columns - by_state[begin:end] @ change)[scored - begin:]
        here = slice(*left.edges[k:k + 2])
        np.testing.assert_allclose(left.residual[here], rest[:, 0], atol=1e-4)
        np.testing.assert_allclose(left.jacobian[here], rest[:, 1:], atol=1e-4)
        np.testing.assert_allclose(left.change[k], change[:, 0], rtol=1e-3)
        assert left.rms[k] == pytest.approx(np.sqrt(np.mean(rest[:, 0] ** 2)), rel=1e-4)
