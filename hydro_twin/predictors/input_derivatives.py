"""Derivatives of the inputs with respect to their delays."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.predictors.kernel import floor
from hydro_twin.predictors.rows import put


@compiled
def input_rows(step, tangent, part, inputs, k, U0, U1):  # type: ignore[no-untyped-def]
    """Write the derivatives of the inputs at start and end of a part of a step.

    At a sample, where the derivatives are one-sided, they are those towards a smaller delay.
    """
    for j in tangent.shifts:
        begin = part / step.substeps - step.shift[j]
        end = (part + 1) / step.substeps - step.shift[j]
        if step.held[j]:
            rise = -(held_at(inputs, j, k, end) - held_at(inputs, j, k, begin)) / (end - begin)
            put(U0, j, rise, tangent.shift, j)
            put(U1, j, rise, tangent.shift, j)
        else:
            put(U0, j, -slope_at(inputs, j, k, begin), tangent.shift, j)
            put(U1, j, -slope_at(inputs, j, k, end), tangent.shift, j)


@compiled
def held_at(inputs, j, k, time):  # type: ignore[no-untyped-def]
    """Input j, held, at a time in samples after sample k-1."""
    return inputs[min(max(k - 1 + floor(time), 0), k), j]


@compiled
def slope_at(inputs, j, k, time):  # type: ignore[no-untyped-def]
    """Slope of input j, interpolated, after a time in samples after sample k-1."""
    before = k - 1 + floor(time)
    return inputs[min(max(before + 1, 0), k), j] - inputs[min(max(before, 0), k), j]
