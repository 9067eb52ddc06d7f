"""Fine steps in continuous time: Runge-Kutta for what is smooth, implicit for what sticks.

All that holds at one instant lies in one vector w = [x, u, d]: states, inputs, and what the
effects add to the value of each port.
"""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.effects.dispatch import call


@compiled
def dot(rows, i, w):  # type: ignore[no-untyped-def]
    """Scalar product of row i with w."""
    value = 0.0
    for j in range(len(w)):
        value += rows[i, j] * w[j]
    return value


@compiled
def read(observed, first, second, w, s):  # type: ignore[no-untyped-def]
    """Write the signals that an effect reads into s; the row of one that it does not is -1."""
    if first >= 0:
        s[0] = dot(observed[1], first, w)
    if second >= 0:
        s[1] = dot(observed[1], second, w)


@compiled
def pass_ports(observed, table, p, z, h, s, z_next, w):  # type: ignore[no-untyped-def]
    """Go through the ports in order: fill the d of w and z_next; returns the value of the last.

    An effect that is implicit adds nothing here; see `stick`.
    """
    ports = len(observed[0])
    first_d = len(w) - ports
    for i in range(first_d, len(w)):
        w[i] = 0.0
    value = 0.0
    for port in range(ports):
        value = dot(observed[0], port, w)
        for e in range(len(table)):
            code, at, first, second, p0, p1, z0, z1, implicit = table[e]
            if at == port and not implicit:
                read(observed, first, second, w, s)
                after = call(code, value, s, p[p0:p1], z[z0:z1], h, 0.0, z_next[z0:z1])
                w[first_d + port] += after - value
                value = after
    return value


@compiled
def rates(  # type: ignore[no-untyped-def]
        rate_rows, observed, table, p, x, u, z, s, z_next, w, slope):
    """Fill slope with x' at these states and inputs; the effects remember nothing of it."""
    n, m = len(x), len(u)
    for i in range(n):
        w[i] = x[i]
    for i in range(m):
        w[n + i] = u[i]
    pass_ports(observed, table, p, z, 0.0, s, z_next, w)
    for i in range(n):
        slope[i] = dot(rate_rows, i, w)


@compiled
def stick(observed, table, p, z, h, gain, s, z_next, w, held):  # type: ignore[no-untyped-def]
    """Add to x the forces that depend on where the step ends: those of the implicit effects.

    Leaves in `held` what they add to each port.
    """
    for i in range(len(held)):
        held[i] = 0.0
    for e in range(len(table)):
        code, port, first, second, p0, p1, z0, z1, implicit = table[e]
        if implicit:
            read(observed, first, second, w, s)
            rise = dot(observed[1], first, gain[port])
            force = call(code, 0.0, s, p[p0:p1], z[z0:z1], h, rise, z_next[z0:z1])
            held[port] += force
            for i in range(len(w)):
                w[i] += force * gain[port, i]


@compiled
def integrate(  # type: ignore[no-untyped-def]
        rate_rows, observed, table, p, h, gain, x, z, inputs, steps, y, work):
    """Move x and z in place over all inputs; y gets what is measured after every `steps` steps.

    Args:
        rate_rows: x' for w, shape (n, n + m + P).
        observed: values of the ports (P, n + m + P), the same and their signals
            (P + S, n + m + P), and what the sensors read (R, n + m + P) for w.
        table: for each effect its code, port, two signal rows or -1, the start and end of its
            parameters in p and of its memory in z, and whether it is implicit; shape (K, 9).
        p: parameters of the effects.
        h: length of a step [s].
        gain: what a unit added to each port over a step does to w, shape (P, n + m + P).
        x: states, shape (n,).
        z: memory of the effects.
        inputs: at the start, the middle and the end of every step, shape (steps samples, 3, m).
        steps: steps between two samples.
        y: the output and the sensors at each sample, shape (samples, 1 + R).
        work: (7, >= largest of n + m + P and memory) scratch.
    """
    n, m = len(x), inputs.shape[2]
    w, z_next, s = work[0, :rate_rows.shape[1]], work[1, :len(z)], work[2, :2]
    slope, total, at = work[3, :n], work[4, :n], work[5, :n]
    held = work[6, :len(observed[0])]
    for k in range(len(inputs)):
        for i in range(n):
            total[i] = 0.0
            at[i] = x[i]
        for stage in range(4):              # the classical one: weights 1, 2, 2, 1
            rates(rate_rows, observed, table, p, at, inputs[k, (stage + 1) // 2], z, s, z_next, w,
                  slope)
            weight = h / 6.0 if stage in (0, 3) else h / 3.0
            reach = h if stage == 2 else 0.5 * h
            for i in range(n):
                total[i] += weight * slope[i]
                at[i] = x[i] + reach * slope[i]
        for i in range(n):
            w[i] = x[i] + total[i]
        for i in range(m):
            w[n + i] = inputs[k, 2, i]
        for i in range(len(z)):
            z_next[i] = z[i]
        pass_ports(observed, table, p, z, h, s, z_next, w)
        stick(observed, table, p, z, h, gain, s, z_next, w, held)
        for i in range(n):
            x[i] = w[i]
        for i in range(len(z)):
            z[i] = z_next[i]
        if (k + 1) % steps == 0:
            y[k // steps, 0] = pass_ports(observed, table, p, z, 0.0, s, z_next, w)
            for i in range(len(held)):
                w[n + m + i] += held[i]
            for i in range(len(observed[2])):
                y[k // steps, 1 + i] = dot(observed[2], i, w)
