"""The compiled step of a plant with effects: the same in the fit, in replay and in the node.

The linear laws are stepped exactly (matrix exponential, inputs and effects linear over a step).
What an effect adds to its port is evaluated at the start of a step and at its predicted end, which
is of second order; a force that jumps with the velocity is solved for the end of the step. With no
effects, and with inputs that act at the samples, the step is exact at any length.

z holds the memory of all effects, then one number for each effect: what it added last, if it is
implicit.

Everything a step needs is in one `Step`, see `assemble` in system.py.
"""
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_twin.compiled import compiled, inlined
from hydro_twin.effects.dispatch import apply

# An effect on a port: the code of its law, the port, the rows of the signals it reads (-1: none),
# where its parameters and its memory begin and end, and whether it is implicit.
ENTRY = np.dtype([(name, np.int64) for name in (
    'code', 'port', 'signal_0', 'signal_1', 'p_begin', 'p_end', 'z_begin', 'z_end', 'implicit')])

LIMIT = 1e12                                # an output beyond this has diverged


class Step(NamedTuple):
    """What a step needs, for n states, m inputs, P ports with S signals, R sensors, K effects.

    Attributes:
        M: (n, n + 2m + 2P): x, inputs at start and end, what effects add at both -> next x.
        H: (P + S + R, n + m + P): x, inputs, what effects add -> values of the ports, then
            signals, then what the sensors read.
        effects: (K,) of `ENTRY`.
        active: the ports with effects that are not implicit, (Q,).
        p: parameters of the effects, one after another.
        shift: how late each input acts [samples], at least -1, (m,).
        held: which inputs keep their value until the next sample, (m,).
        substeps: steps in a sample.
        sample_time: [s].
        sensors: the row of H of the first sensor.
    """

    M: npt.NDArray[np.float64]
    H: npt.NDArray[np.float64]
    effects: npt.NDArray[np.void]
    active: npt.NDArray[np.int64]
    p: npt.NDArray[np.float64]
    shift: npt.NDArray[np.float64]
    held: npt.NDArray[np.bool_]
    substeps: int
    sample_time: float
    sensors: int


@inlined
def input_between(inputs, j, held, k, begin, end):  # type: ignore[no-untyped-def]
    """Input j at start and end, times in samples after sample k-1.

    A held input is its mean over the interval at both ends; a measured one is interpolated. Times
    count from k-1, not from the first sample, so that digits do not depend on how long a run is.
    """
    if held:
        first, last = floor(begin), floor(end)
        value = inputs[min(max(k - 1 + first, 0), k), j]
        if last > first and end > last:
            share = (end - last) / (end - begin)
            value += share * (inputs[min(max(k - 1 + last, 0), k), j] - value)
        return value, value
    return interpolated(inputs, j, k, begin), interpolated(inputs, j, k, end)


@inlined
def floor(time):  # type: ignore[no-untyped-def]
    """Return the largest whole number not above."""
    whole = int(time)
    return whole - 1 if whole > time else whole


@inlined
def interpolated(inputs, j, k, time):  # type: ignore[no-untyped-def]
    """Input j at a time in samples after sample k-1."""
    whole = floor(time)
    before = inputs[min(max(k - 1 + whole, 0), k), j]
    if time == whole:
        return before
    return before + (time - whole) * (inputs[min(max(k + whole, 0), k), j] - before)


@inlined
def observe(H, row, x, u, d, active):  # type: ignore[no-untyped-def]
    """One row of H: the value of a port, or a signal."""
    n, m = len(x), len(u)
    value = 0.0
    for i in range(n):
        value += H[row, i] * x[i]
    for i in range(m):
        value += H[row, n + i] * u[i]
    for i in active:
        value += H[row, n + m + i] * d[i]
    return value


@inlined
def add_effects(step, x, u, z, h, s, z_next, d):  # type: ignore[no-untyped-def]
    """Write into d what the explicit effects add to each port, in the order of the table."""
    H, active = step.H, step.active
    for i in active:
        d[i] = 0.0
    for e in range(len(step.effects)):
        effect = step.effects[e]
        if effect.implicit:
            continue
        before = observe(H, effect.port, x, u, d, active) + d[effect.port]
        if effect.signal_0 >= 0:
            s[0] = observe(H, effect.signal_0, x, u, d, active)
        if effect.signal_1 >= 0:
            s[1] = observe(H, effect.signal_1, x, u, d, active)
        after = apply(effect.code, before, s, step.p[effect.p_begin:effect.p_end],
                      z[effect.z_begin:effect.z_end], h, 0.0,
                      z_next[effect.z_begin:effect.z_end])
        d[effect.port] += after - before


@inlined
def inputs_over(step, part, inputs, k, begin, end):  # type: ignore[no-untyped-def]
    """Write the inputs at start and end of a part of the step from sample k-1 to sample k."""
    for j in range(len(step.shift)):
        now = inputs[k - 1, j]
        if step.shift[j] != 0.0:
            begin[j], end[j] = input_between(
                inputs, j, step.held[j], k, part / step.substeps - step.shift[j],
                (part + 1) / step.substeps - step.shift[j])
        elif step.held[j]:
            begin[j], end[j] = now, now
        else:
            slope = (inputs[k, j] - now) / step.substeps
            begin[j], end[j] = now + part * slope, now + (part + 1) * slope


@inlined
def advance(step, x, z, work, inputs, k, everywhere):  # type: ignore[no-untyped-def]
    """Step x and z in place from sample k-1 to sample k of the inputs; returns the output at k.

    work is scratch, see `System.work`; for `everywhere` see `output`.
    """
    M, H, active, p = step.M, step.H, step.active, step.p
    n, m, K = len(x), len(step.shift), len(step.effects)
    P = H.shape[1] - n - m
    begin, end, linear, ahead = work[0, :m], work[1, :m], work[2, :n], work[3, :n]
    d0, d1, z_next, s = work[4, :P], work[5, :P], work[6, :len(z)], work[7]
    h = step.sample_time / step.substeps
    kept, at = len(z) - K, n + 2 * m
    for part in range(step.substeps):
        inputs_over(step, part, inputs, k, begin, end)
        for i in range(n):
            value = 0.0
            for j in range(n):
                value += M[i, j] * x[j]
            for j in range(m):
                value += M[i, n + j] * begin[j] + M[i, n + m + j] * end[j]
            linear[i] = value
        if K > 0:
            for i in range(len(z)):
                z_next[i] = z[i]
            here, u, d, time = x, begin, d0, 0.0
            # One call for both ends of the step, so that there is half as much code to fetch.
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
                    here, u, d, time = ahead, end, d1, h
                add_effects(step, here, u, z, time, s, z_next, d)
            for i in range(n):
                for j in active:
                    linear[i] += M[i, at + j] * d0[j] + M[i, at + P + j] * d1[j]
            for e in range(K):
                effect = step.effects[e]
                if not effect.implicit:
                    continue
                port = effect.port
                compliance = 0.0
                for i in range(n):
                    compliance += H[effect.signal_0, i] * (M[i, at + port] + M[i, at + P + port])
                s[0] = observe(H, effect.signal_0, linear, end, d1, active)
                added = apply(effect.code, 0.0, s, p[effect.p_begin:effect.p_end],
                              z[effect.z_begin:effect.z_end], h, compliance,
                              z_next[effect.z_begin:effect.z_end])
                for i in range(n):
                    linear[i] += (M[i, at + port] + M[i, at + P + port]) * added
                z_next[kept + e] = added
            for i in range(len(z)):
                z[i] = z_next[i]
        for i in range(n):
            x[i] = linear[i]
    return output(step, x, z, work, inputs, k, everywhere)


@inlined
def output(step, x, z, work, inputs, k, everywhere):  # type: ignore[no-untyped-def]
    """Return the last port at sample k; leaves inputs in work[1], what effects add in work[5].

    What the effects add is computed where it reaches the output directly, and otherwise only if
    `everywhere` is set. A delayed input is interpolated here, a held one too: that matters only
    where an input reaches a port, signal or sensor directly.
    """
    m = len(step.shift)
    P = step.H.shape[1] - len(x) - m
    u, d = work[1, :m], work[5, :P]
    for j in range(m):
        u[j] = inputs[k, j]
        if step.shift[j] > 0.0:
            u[j] = interpolated(inputs, j, k, 1.0 - step.shift[j])
    found = everywhere
    for i in step.active:
        found = found or i == P - 1 or step.H[P - 1, len(x) + m + i] != 0.0
    if found:
        z_next = work[6, :len(z)]
        for i in range(len(z)):
            z_next[i] = z[i]
        add_effects(step, x, u, z, 0.0, work[7], z_next, d)
    return observe(step.H, P - 1, x, u, d, step.active) + d[P - 1]


@compiled
def read_sensor(step, row, x, z, u, d):  # type: ignore[no-untyped-def]
    """Return what the sensor in a row of H reads, with what implicit effects added last."""
    n, m, kept = len(x), len(u), len(z) - len(step.effects)
    value = observe(step.H, row, x, u, d, step.active)
    for e in range(len(step.effects)):
        if step.effects[e].implicit:
            value += step.H[row, n + m + step.effects[e].port] * z[kept + e]
    return value


def live_fields(step: Step) -> tuple[Any, ...]:
    """Return the fields of a step as `live_step` takes them, the effects as plain integers."""
    return tuple(step._replace(effects=step.effects.view(np.int64)))


@compiled
def live_step(x, z, work, inputs, k, M, H, effects, *others):  # type: ignore[no-untyped-def]
    """`advance` for a caller in Python; nan where the run has diverged.

    It takes the fields of a `Step` one by one, and the effects as plain integers, since these are
    passed faster.
    """
    y = advance(Step(M, H, effects.view(ENTRY), *others), x, z, work, inputs, k, False)
    return y if abs(y) < LIMIT else float('nan')


@compiled
def run(step, x, z, work, inputs, y, seen, first, last):  # type: ignore[no-untyped-def]
    """Fill y with the output at samples first <= k < last of the inputs (N, m).

    From state x and memory z, those of the sample before the first, which are updated in place.
    Where `seen` (N, P + S or more) is not empty it gets the values of ports, signals and as many
    sensors as it has columns for. A run that diverges is left at nan from there on.
    """
    for k in range(first, last):
        if k == 0:
            y[k] = output(step, x, z, work, inputs, k, len(seen) > 0)
        else:
            y[k] = advance(step, x, z, work, inputs, k, len(seen) > 0)
        if not abs(y[k]) < LIMIT:
            y[k:] = float('nan')
            return
        if len(seen) > 0:
            m = len(step.shift)
            u, d = work[1, :m], work[5, :step.H.shape[1] - len(x) - m]
            for row in range(step.sensors):
                seen[k, row] = observe(step.H, row, x, u, d, step.active)
                if row < len(d):
                    seen[k, row] += d[row]
            for row in range(step.sensors, seen.shape[1]):
                seen[k, row] = read_sensor(step, row, x, z, u, d)


@compiled
def run_stretches(step, x, z, work, inputs, y, seen, stretches):  # type: ignore[no-untyped-def]
    """Fill y (N,) by runs over parts that follow one another in the inputs (N, m).

    Stretches as in sensitivities.py; x (P, n) and z (P, memory) of the parts are updated
    in place.
    """
    for r in range(len(stretches)):
        part, begin, end = stretches[r, 0], stretches[r, 1], stretches[r, 2]
        first, last = stretches[r, 3], stretches[r, 4]
        if first > 0 and y[begin + first - 1] != y[begin + first - 1]:
            y[begin + first:begin + last] = float('nan')
        else:
            run(step, x[part], z[part], work, inputs[begin:end], y[begin:end], seen, first, last)


@compiled
def output_each(step, x, z, work, inputs, y):  # type: ignore[no-untyped-def]
    """Fill y (K,) with the output under inputs (K, m) in each state x (K, n) with memory z.

    The memory (K, memory) becomes what the effects keep after that.
    """
    for k in range(len(y)):
        y[k] = output(step, x[k], z[k], work, inputs[k:k + 1], 0, True)
        for i in range(z.shape[1]):
            z[k, i] = work[6, i]


@compiled
def respond(Phi, response):  # type: ignore[no-untyped-def]
    """Fill response (N, n) from its first row on, with how the output follows each state.

    By the linear laws: a row is the one before it, times Phi (n, n) of a sample.
    """
    n = len(Phi)
    for k in range(1, len(response)):
        for i in range(n):
            value = 0.0
            for j in range(n):
                value += response[k - 1, j] * Phi[j, i]
            response[k, i] = value


@compiled
def eq_1(a, b, past, inputs, k):  # type: ignore[no-untyped-def]
    """Eq. 1 at sample k, from past[k-1], ..., past[k-n] and inputs[k], ..., inputs[k-n]."""
    value = 0.0
    for i in range(len(a)):
        value -= a[i] * past[k - 1 - i]
    for i in range(len(b)):
        for j in range(b.shape[1]):
            value += b[i, j] * inputs[k - i, j]
    return value


@compiled
def run_one_step(a, b, added, measured, inputs, past, y):  # type: ignore[no-untyped-def]
    """Fill y with `step_one` at each sample; past is scratch, all shape (N,)."""
    for k in range(len(y)):
        y[k] = step_one(a, b, added[k], measured[k], inputs, past, k, k >= len(a))


@compiled
def step_one(a, b, added, measured, inputs, past, k, started):  # type: ignore[no-untyped-def]
    """Predict sample k by eq. 1 on the past less what effects add; then take in the measured.

    A sample that was not measured counts as it was predicted.
    """
    predicted = added + eq_1(a, b, past, inputs, k) if started else float('nan')
    if measured == measured:
        past[k] = measured - added
    elif started:
        past[k] = predicted - added
    else:
        past[k] = 0.0
    return predicted
