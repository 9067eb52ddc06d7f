"""Derivatives at the ports: of signals there, of what effects add, and of the state by that."""
from __future__ import annotations

from hydro_twin.compiled import compiled, inlined
from hydro_twin.predictors.kernel import observe
from hydro_twin.predictors.law_derivatives import (
    add_chain,
    BEFORE,
    differentiate_law,
    linearise,
    reads,
    SIGNAL,
)
from hydro_twin.predictors.rows import add, clear, combine


@inlined
def observe_rows(step, tangent, row, x, u, d, X, U, D, out, i):  # type: ignore[no-untyped-def]
    """Write the derivatives of a row of H at x, inputs u and what effects add, d."""
    H, dH, moves = step.H, tangent.H, tangent.H_varies
    n, m = len(x), len(u)
    at = row * H.shape[1]
    clear(out, i)
    for j in range(n):
        if H[row, j] != 0.0:
            add(out, i, H[row, j], X, j)
        if moves[row, j]:
            add(out, i, x[j], dH, at + j)
    for j in range(m):
        if moves[row, n + j]:
            add(out, i, u[j], dH, at + n + j)
    for j in tangent.shifts:
        if H[row, n + j] != 0.0:
            add(out, i, H[row, n + j], U, j)
    for j in step.active:
        if H[row, n + m + j] != 0.0:
            add(out, i, H[row, n + m + j], D, j)
        if moves[row, n + m + j]:
            add(out, i, d[j], dH, at + n + m + j)


@inlined
def add_effects(  # type: ignore[no-untyped-def]
        step, tangent, x, u, z, h, s, z_next, d, X, U, D, Z, Z_next, spare, g):
    """Do what `kernel.add_effects` does, and write the derivatives into D and Z_next.

    Derivatives on which a law does not depend are skipped: a limit that is not reached adds
    nothing, whatever its input.
    """
    H, active = step.H, step.active
    for i in active:
        d[i] = 0.0
        clear(D, i)
    for e in range(len(step.effects)):
        effect = step.effects[e]
        if effect.implicit:
            continue
        port = effect.port
        before = observe(H, port, x, u, d, active) + d[port]
        if effect.signal_0 >= 0:
            s[0] = observe(H, effect.signal_0, x, u, d, active)
        if effect.signal_1 >= 0:
            s[1] = observe(H, effect.signal_1, x, u, d, active)
        after = differentiate_law(step, e, before, s, z, h, 0.0, z_next, g)
        if reads(step, tangent, e, 0, 1.0, g):
            observe_rows(step, tangent, port, x, u, d, X, U, D, spare, BEFORE)
            add(spare, BEFORE, 1.0, D, port)
        if effect.signal_0 >= 0 and reads(step, tangent, e, 1, 0.0, g):
            observe_rows(step, tangent, effect.signal_0, x, u, d, X, U, D, spare, SIGNAL)
        if effect.signal_1 >= 0 and reads(step, tangent, e, 2, 0.0, g):
            observe_rows(step, tangent, effect.signal_1, x, u, d, X, U, D, spare, SIGNAL + 1)
        if tangent.rest >= 0:
            after = linearise(step, tangent, e, before, after, s, z, h, 0.0, z_next, spare, g, D,
                              port)
        d[port] += after - before
        add_chain(step, tangent, e, 1.0, Z, Z_next, spare, g, D, port)


@compiled
def add_to_port(step, tangent, out, port, v, at, D, j, apart):  # type: ignore[no-untyped-def]
    """Add the derivatives of the contribution of one port to the state at the end of a step.

    The value at the start of the step is v[at], with its derivatives in row j of D; those at the
    end are `apart` further on.
    """
    M, n, m = step.M, len(step.M), len(step.shift)
    width, P = M.shape[1], step.H.shape[1] - n - m
    column = n + 2 * m + port
    combine(out, n, False, M, column, width, P, D, j, 0, apart, 2)
    if tangent.M_varies and (v[at] != 0.0 or v[at + apart] != 0.0):
        combine(out, n, False, v, at, 0, apart, tangent.M, column, width, P, 2)
