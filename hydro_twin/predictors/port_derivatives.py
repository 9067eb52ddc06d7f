"""Derivatives at the ports: of signals there, of what effects add, and of the state by that."""
from __future__ import annotations

from hydro_twin.compiled import compiled, inlined
from hydro_twin.predictors.kernel import observe
from hydro_twin.predictors.law_derivatives import AFTER, BEFORE, linearise, SIGNAL
from hydro_twin.predictors.rows import add, clear, combine, copy


@inlined
def observe_rows(step, tangent, row, x, u, d, X, U, D, out, i):  # type: ignore[no-untyped-def]
    """Write the derivatives of a row of H at x, inputs u and what effects add, d."""
    H, dH, moves = step.H, tangent.H, tangent.moves
    n, m = len(x), len(u)
    at = row * H.shape[1]
    clear(out, i)
    for j in range(n):
        if H[row, j] != 0.0:
            add(out, i, H[row, j], X, j)
        if moves[row, j]:
            add(out, i, x[j], dH, at + j)
    for j in range(m):
        if H[row, n + j] != 0.0 and tangent.shifts:
            add(out, i, H[row, n + j], U, j)
        if moves[row, n + j]:
            add(out, i, u[j], dH, at + n + j)
    for j in step.active:
        if H[row, n + m + j] != 0.0:
            add(out, i, H[row, n + m + j], D, j)
        if moves[row, n + m + j]:
            add(out, i, d[j], dH, at + n + m + j)


@inlined
def add_effects(  # type: ignore[no-untyped-def]
        step, tangent, x, u, z, h, s, z_next, d, X, U, D, Z, Z_next, spare, g):
    """Do what `kernel.add_effects` does, and write the derivatives into D and Z_next."""
    H, active = step.H, step.active
    for i in active:
        d[i] = 0.0
        clear(D, i)
    for i in range(len(z)):
        z_next[i] = z[i]
    copy(Z_next, Z, len(z))
    for e in range(len(step.effects)):
        effect = step.effects[e]
        if effect.implicit:
            continue
        port = effect.port
        before = observe(H, port, x, u, d, active) + d[port]
        observe_rows(step, tangent, port, x, u, d, X, U, D, spare, BEFORE)
        add(spare, BEFORE, 1.0, D, port)
        if effect.signal_0 >= 0:
            s[0] = observe(H, effect.signal_0, x, u, d, active)
            observe_rows(step, tangent, effect.signal_0, x, u, d, X, U, D, spare, SIGNAL)
        if effect.signal_1 >= 0:
            s[1] = observe(H, effect.signal_1, x, u, d, active)
            observe_rows(step, tangent, effect.signal_1, x, u, d, X, U, D, spare, SIGNAL + 1)
        after = linearise(step, tangent, e, before, s, z, h, 0.0, z_next, Z, Z_next, spare, g)
        d[port] += after - before
        add(D, port, 1.0, spare, AFTER)
        add(D, port, -1.0, spare, BEFORE)


@compiled
def add_to_port(  # type: ignore[no-untyped-def]
        step, tangent, out, port, first, times, values, v, rows, j):
    """Add the derivatives of what a value at a port does to the state at the end of a step.

    It is values[v], with its derivatives in row j of rows. `first` and `times` say when it is
    there: at the start of the step (0, 1), at its end (1, 1), or at both (0, 2).
    """
    M, n, m = step.M, len(step.M), len(step.shift)
    width, P = M.shape[1], step.H.shape[1] - n - m
    at = n + 2 * m + port + first * P
    combine(out, n, False, M, at, width, P, rows, j, 0, 0, times)
    if tangent.moving and values[v] != 0.0:
        combine(out, n, False, values, v, 0, 0, tangent.M, at, width, P, times)
