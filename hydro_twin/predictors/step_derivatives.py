"""The compiled step with its derivatives.

`advance` and `output` reproduce those of the kernel to the last digit, and also propagate
derivatives with respect to D unknowns: X (n, D) of the state x, Z (memory, D) of the effects'
memory z, and (D,) of the output. The unknowns of the plant come first, since only they change the
matrices.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.compiled import compiled, inlined
from hydro_twin.predictors import kernel
from hydro_twin.predictors.input_derivatives import input_rows, slope_at
from hydro_twin.predictors.kernel import inputs_over, interpolated, observe
from hydro_twin.predictors.law_derivatives import (
    add_chain,
    AFTER,
    BEFORE,
    differentiate_law,
    linearise,
    reads,
    SIGNAL,
    SPARE,
)
from hydro_twin.predictors.port_derivatives import add_effects, add_to_port, observe_rows
from hydro_twin.predictors.rows import add, clear, combine, copy, put, WIDTH, zeros
from hydro_twin.predictors.system import System


class Rows(NamedTuple):
    """Derivatives of what a step computes, each (how many, blocks, `WIDTH`): D columns in blocks.

    Attributes:
        X, Z: of the state and the memory.
        U: of the inputs at the start of a part of the step, then at its end.
        D: of what effects add to the ports there, likewise.
        L: of the state at the end by the linear laws, then with all that is added.
        A: of that predicted from what is added at the start.
        Z_next: of the memory at the end.
        spare: of single values.
    """

    X: FloatArray
    Z: FloatArray
    U: FloatArray
    D: FloatArray
    L: FloatArray
    A: FloatArray
    Z_next: FloatArray
    spare: FloatArray


def _counts(system: System) -> tuple[int, ...]:
    """Say how many rows there are of each kind, in the order of `Rows`."""
    n, m, W, P = (len(system.laws.A), len(system.step.shift), system.memory,
                  len(system.plant.ports))
    return n, W, 2 * m, 2 * P, n, n, W, SPARE


def rows_for(system: System, blocks: int) -> FloatArray:
    """Allocate the rows of all of `Rows`, one after another, so many blocks of columns each."""
    return zeros(sum(_counts(system)), blocks)


@compiled
def divided(X, Z, room, m, P):  # type: ignore[no-untyped-def]
    """Make `Rows` of X, Z and room for the others, which come after them in `rows_for`.

    Compiled code has fewer pointers to keep in registers with one array than with nine.
    """
    n, W = len(X), len(Z)
    D = 2 * m
    L = D + 2 * P
    Z_next = L + 2 * n
    return Rows(X, Z, room[:D], room[D:L], room[L:L + n], room[L + n:Z_next],
                room[Z_next:Z_next + W], room[Z_next + W:])


def partials(system: System) -> FloatArray:
    """Allocate what derivatives of a law are written to, twice."""
    return np.zeros((2, 1 + system.memory, 5 + len(system.step.p) + system.memory))


@inlined
def advance(step, tangent, x, z, work, rows, g, inputs, k):  # type: ignore[no-untyped-def]
    """Step state, memory and their derivatives in place from sample k-1 to sample k."""
    M, H, active, dM = step.M, step.H, step.active, tangent.M
    X, Z, U, D, L, A, Z_next, spare = rows
    n, m, K, W = len(x), len(step.shift), len(step.effects), len(z)
    width, P, at = M.shape[1], H.shape[1] - n - m, n + 2 * m
    U0, U1, D0, D1 = U[:m], U[m:], D[:P], D[P:]
    v, linear, ahead = work[0, :width], work[2, :n], work[3, :n]
    begin, end, d0, d1 = v[n:n + m], v[n + m:at], v[at:at + P], v[at + P:]
    z_next, s = work[6, :W], work[7]
    h = step.sample_time / step.substeps
    kept = W - K
    for part in range(step.substeps):
        for i in range(n):
            v[i] = x[i]
        inputs_over(step, part, inputs, k, begin, end)
        if len(tangent.shifts) > 0:
            input_rows(step, tangent, part, inputs, k, U0, U1)
        for i in range(n):
            value = 0.0
            for j in range(n):
                value += M[i, j] * x[j]
            for j in range(m):
                value += M[i, n + j] * begin[j] + M[i, n + m + j] * end[j]
            linear[i] = value
        combine(L, n, True, M, 0, width, 1, X, 0, 0, 1, n)
        if tangent.M_varies:
            combine(L, n, False, v, 0, 0, 1, dM, 0, width, 1, at)
        for j in tangent.shifts:
            combine(L, n, False, M, n + j, width, m, U, j, 0, m, 2)
        if K > 0:
            for i in range(W):
                z_next[i] = z[i]
            here, u, d, time = x, begin, d0, 0.0
            by_here, by_u, by_d = X, U0, D0
            for at_end in range(2 if len(active) > 0 else 0):
                if at_end:
                    for i in range(n):
                        value = linear[i]
                        for j in active:
                            value += (M[i, at + j] + M[i, at + P + j]) * d0[j]
                        for e in range(K):
                            if step.effects[e].implicit:
                                j = step.effects[e].port
                                value += (M[i, at + j] + M[i, at + P + j]) * z[kept + e]
                        ahead[i] = value
                    copy(A, L, n)
                    for j in active:
                        add_to_port(step, tangent, A, j, v, at + j, D, j, 0)
                    for e in range(K):
                        if step.effects[e].implicit:
                            add_to_port(step, tangent, A, step.effects[e].port, z, kept + e, Z,
                                        kept + e, 0)
                    here, u, d, time = ahead, end, d1, h
                    by_here, by_u, by_d = A, U1, D1
                add_effects(step, tangent, here, u, z, time, s, z_next, d, by_here, by_u, by_d, Z,
                            Z_next, spare, g)
            for i in range(n):
                for j in active:
                    linear[i] += M[i, at + j] * d0[j] + M[i, at + P + j] * d1[j]
            for j in active:
                add_to_port(step, tangent, L, j, v, at + j, D, j, P)
            for e in range(K):
                effect = step.effects[e]
                if not effect.implicit:
                    continue
                port = effect.port
                s[0] = observe(H, effect.signal_0, linear, end, d1, active)
                added = differentiate_law(step, e, 0.0, s, z, h, tangent.compliance[e], z_next, g)
                if reads(step, tangent, e, 1, 0.0, g):
                    observe_rows(step, tangent, effect.signal_0, linear, end, d1, L, U1, D1, spare,
                                 SIGNAL)
                clear(spare, BEFORE)
                clear(spare, AFTER)
                if tangent.rest >= 0:
                    added = linearise(step, tangent, e, 0.0, added, s, z, h,
                                      tangent.compliance[e], z_next, spare, g, spare, AFTER)
                add_chain(step, tangent, e, 0.0, Z, Z_next, spare, g, spare, AFTER)
                for i in range(n):
                    linear[i] += (M[i, at + port] + M[i, at + P + port]) * added
                z_next[kept + e] = added
                add_to_port(step, tangent, L, port, z_next, kept + e, spare, AFTER, 0)
                put(Z_next, kept + e, 1.0, spare, AFTER)
            for i in range(W):
                z[i] = z_next[i]
            copy(Z, Z_next, W)
        for i in range(n):
            x[i] = linear[i]
        copy(X, L, n)


@inlined
def output(  # type: ignore[no-untyped-def]
        step, tangent, x, z, work, rows, g, inputs, k, everywhere, dy):
    """Return the output at sample k and write its derivatives into dy (D,).

    For `everywhere` see `kernel.output`.
    """
    X, Z, U, D, _, _, Z_next, spare = rows
    m, n, W = len(step.shift), len(x), len(z)
    P = step.H.shape[1] - n - m
    D1 = D[P:]
    u, d = work[1, :m], work[5, :P]
    for j in range(m):
        u[j] = inputs[k, j]
        if step.shift[j] > 0.0:
            u[j] = interpolated(inputs, j, k, 1.0 - step.shift[j])
    for j in tangent.shifts:
        clear(U, j)
        if step.shift[j] > 0.0:
            put(U, j, -slope_at(inputs, j, k, 1.0 - step.shift[j]), tangent.shift, j)
    found = everywhere
    for j in step.active:
        found = (found or j == P - 1 or step.H[P - 1, n + m + j] != 0.0
                 or tangent.H_varies[P - 1, n + m + j])
    if found:
        z_next = work[6, :W]
        for i in range(W):
            z_next[i] = z[i]
        add_effects(step, tangent, x, u, z, 0.0, work[7], z_next, d, X, U, D1, Z, Z_next, spare, g)
    observe_rows(step, tangent, P - 1, x, u, d, X, U, D1, spare, BEFORE)
    add(spare, BEFORE, 1.0, D1, P - 1)
    for q in range(len(dy)):
        dy[q] = spare[BEFORE, q // WIDTH, q % WIDTH]
    return observe(step.H, P - 1, x, u, d, step.active) + d[P - 1]


@compiled
def read_sensor(step, tangent, row, x, z, work, rows, dy):  # type: ignore[no-untyped-def]
    """Return what the sensor in a row of H reads, after `output`; its derivatives go to dy."""
    X, Z, U, D, _, _, _, spare = rows
    n, m, kept = len(x), len(step.shift), len(z) - len(step.effects)
    P = step.H.shape[1] - n - m
    u, d = work[1, :m], work[5, :P]
    observe_rows(step, tangent, row, x, u, d, X, U, D[P:], spare, BEFORE)
    for e in range(len(step.effects)):
        if step.effects[e].implicit:
            column = n + m + step.effects[e].port
            if step.H[row, column] != 0.0:
                add(spare, BEFORE, step.H[row, column], Z, kept + e)
            if tangent.H_varies[row, column]:
                add(spare, BEFORE, z[kept + e], tangent.H, row * step.H.shape[1] + column)
    for q in range(len(dy)):
        dy[q] = spare[BEFORE, q // WIDTH, q % WIDTH]
    return kernel.read_sensor(step, row, x, z, u, d)
