"""A free run with its derivatives: by parameters, timing, and the state at its start.

`run` does what the run of the kernel does, to the last digit, and carries beside the state x, the
effects' memory z and the output y their derivatives X (n, D), Z (memory, D) and (N, D) by D
unknowns. Those of the plant come first, since only they move the matrices.
"""
from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from hydro_twin.compiled import compiled
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors import kernel
from hydro_twin.predictors.kernel import floor, inputs_over, interpolated, LIMIT, observe
from hydro_twin.predictors.linearise import average, differentiate, straight
from hydro_twin.predictors.rows import add, clear, in_rows, put, weigh, WIDTH
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import Directions, lasting, Tangent

UNBOUNDED = 1e50        # of a derivative: its products in a fit would overflow

# The rows of `Rows.spare`: value before and after an effect, and the two signals it reads.
BEFORE, AFTER, SIGNAL = 0, 1, 2
SPARE = 4


class Rows(NamedTuple):
    """Derivatives of what a step computes, each (how many, blocks, `WIDTH`): D columns in blocks.

    Attributes:
        X, Z: of the state and the memory.
        U0, U1: of the inputs at begin and end of a part of the step.
        D0, D1: of what effects add to the ports there.
        L: of the state at the end by the linear laws, then with all that is added.
        A: of that predicted from what is added at the begin.
        Z_next: of the memory at the end.
        spare: of single values.
    """

    X: FloatArray
    Z: FloatArray
    U0: FloatArray
    U1: FloatArray
    D0: FloatArray
    D1: FloatArray
    L: FloatArray
    A: FloatArray
    Z_next: FloatArray
    spare: FloatArray


def rows_for(system: System, blocks: int) -> Rows:
    """Return rows of nought, so many blocks of `WIDTH` columns."""
    n, m, W, P = (len(system.laws.A), len(system.step.shift), system.memory,
                  len(system.plant.ports))
    return Rows(*(np.zeros((count, blocks, WIDTH))
                  for count in (n, W, m, m, P, P, n, n, W, SPARE)))


def partials(system: System) -> FloatArray:
    """Allocate what derivatives of a law are written to, twice."""
    return np.zeros((2, 1 + system.memory, 5 + len(system.step.p) + system.memory))


@compiled
def linearise(  # type: ignore[no-untyped-def]
        step, tangent, e, v, s, z, h, c, z_next, Z, Z_next, spare, g):
    """Return what the law of effect e gives; its derivatives go to spare[AFTER] and Z_next.

    Those of the value v and of the signals s are in spare. Where they are roots of covariances,
    the law is made linear over those.
    """
    effect = step.effects[e]
    p, first, last = step.p[effect.p_begin:effect.p_end], effect.z_begin, effect.z_end
    own, kept = z[first:last], z_next[first:last]
    used = g[0, :1 + last - first, :4 + len(p) + last - first]
    value = differentiate(effect.code, v, s, p, own, h, c, kept, used)
    beside = 0.0
    if tangent.rest >= 0:
        read = SIGNAL if effect.signal_0 >= 0 else BEFORE
        square = product = 0.0
        for q in range(tangent.rest):
            by = spare[read, q // WIDTH, q % WIDTH]
            square += by * by
            product += by * spare[BEFORE, q // WIDTH, q % WIDTH]
        ds = math.sqrt(square)
        dv = product / ds if ds > 0.0 else 0.0
        if read == BEFORE:
            ds = 0.0
        if square > 0.0:
            spent = g[1, 0, :last - first]
            if not straight(effect.code, v, s, p, own, h, c, spent, used, value, dv, ds):
                value, beside = average(effect.code, v, s, p, own, h, c, kept, used,
                                        g[1, :1 + last - first, :5 + len(p) + last - first],
                                        dv, ds)
    chain(used[0], step, tangent, e, Z, spare, spare, AFTER)
    if tangent.rest >= 0:
        q = tangent.rest + e
        spare[AFTER, q // WIDTH, q % WIDTH] += beside
    for i in range(last - first):
        chain(used[1 + i], step, tangent, e, Z, spare, Z_next, first + i)
    return value


@compiled
def chain(g, step, tangent, e, Z, spare, out, i):  # type: ignore[no-untyped-def]
    """Write the derivatives of what the law of effect e gives, from its partial derivatives g."""
    effect = step.effects[e]
    put(out, i, g[0], spare, BEFORE)
    for k in range(2):
        if g[1 + k] != 0.0:
            add(out, i, g[1 + k], spare, SIGNAL + k)
    if g[3] != 0.0:
        add(out, i, g[3], tangent.d_compliance, e)
    for k in range(effect.p_begin, effect.p_end):
        if g[4 + k - effect.p_begin] != 0.0:
            add(out, i, g[4 + k - effect.p_begin], tangent.p, k)
    at = 4 + effect.p_end - effect.p_begin
    for k in range(effect.z_begin, effect.z_end):
        if g[at + k - effect.z_begin] != 0.0:
            add(out, i, g[at + k - effect.z_begin], Z, k)


@compiled
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


@compiled
def add_effects(  # type: ignore[no-untyped-def]
        step, tangent, x, u, z, h, s, z_next, d, X, U, D, Z, Z_next, spare, g):
    """Do what the kernel's does, and write the derivatives into D and Z_next."""
    H, active = step.H, step.active
    for i in active:
        d[i] = 0.0
        clear(D, i)
    for i in range(len(z)):
        z_next[i] = z[i]
        put(Z_next, i, 1.0, Z, i)
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
def input_rows(step, tangent, part, inputs, k, U0, U1):  # type: ignore[no-untyped-def]
    """Write the derivatives of the inputs at begin and end of a part of a step.

    Where the later or earlier time is that of a sample, they are those of acting earlier.
    """
    for j in range(len(step.shift)):
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


@compiled
def add_to_port(  # type: ignore[no-untyped-def]
        step, tangent, out, port, begin, end, value, rows, j):
    """Add the derivatives of what a value at a port does to the state at the end of a step.

    begin and end: how much of the value is there then; j: the row of its derivatives.
    """
    M, n, m = step.M, len(step.M), len(step.shift)
    width, P = M.shape[1], step.H.shape[1] - n - m
    at = n + 2 * m + port
    for i in range(n):
        add(out, i, begin * M[i, at] + end * M[i, at + P], rows, j)
        if tangent.moving and begin * value != 0.0:
            add(out, i, begin * value, tangent.M, i * width + at)
        if tangent.moving and end * value != 0.0:
            add(out, i, end * value, tangent.M, i * width + at + P)


@compiled
def advance(step, tangent, x, z, work, rows, g, inputs, k):  # type: ignore[no-untyped-def]
    """Step state, memory and their derivatives in place from sample k-1 to sample k."""
    M, H, active, dM = step.M, step.H, step.active, tangent.M
    X, Z, U0, U1, D0, D1, L, A, Z_next, spare = rows
    n, m, K, W = len(x), len(step.shift), len(step.effects), len(z)
    width, P = M.shape[1], H.shape[1] - n - m
    begin, end, linear, ahead = work[0, :m], work[1, :m], work[2, :n], work[3, :n]
    d0, d1, z_next, s = work[4, :P], work[5, :P], work[6, :W], work[7]
    h = step.sample_time / step.substeps
    kept, at = W - K, n + 2 * m
    for part in range(step.substeps):
        inputs_over(step, part, inputs, k, begin, end)
        if tangent.shifts:
            input_rows(step, tangent, part, inputs, k, U0, U1)
        for i in range(n):
            value = 0.0
            for j in range(n):
                value += M[i, j] * x[j]
            for j in range(m):
                value += M[i, n + j] * begin[j] + M[i, n + m + j] * end[j]
            linear[i] = value
            clear(L, i)
            weigh(L, i, M[i], X, 0, n)
            if tangent.moving:
                weigh(L, i, x, dM, i * width, n)
                weigh(L, i, begin, dM, i * width + n, m)
                weigh(L, i, end, dM, i * width + n + m, m)
            if tangent.shifts:
                weigh(L, i, M[i, n:], U0, 0, m)
                weigh(L, i, M[i, n + m:], U1, 0, m)
        if K > 0:
            add_effects(step, tangent, x, begin, z, 0.0, s, z_next, d0, X, U0, D0, Z, Z_next,
                        spare, g)
            if len(active) > 0:
                for i in range(n):
                    value = linear[i]
                    put(A, i, 1.0, L, i)
                    for j in active:
                        value += (M[i, at + j] + M[i, at + P + j]) * d0[j]
                    for e in range(K):
                        if step.effects[e].implicit:
                            j = step.effects[e].port
                            value += (M[i, at + j] + M[i, at + P + j]) * z[kept + e]
                    ahead[i] = value
                for j in active:
                    add_to_port(step, tangent, A, j, 1.0, 1.0, d0[j], D0, j)
                for e in range(K):
                    if step.effects[e].implicit:
                        add_to_port(step, tangent, A, step.effects[e].port, 1.0, 1.0, z[kept + e],
                                    Z, kept + e)
            add_effects(step, tangent, ahead, end, z, h, s, z_next, d1, A, U1, D1, Z, Z_next,
                        spare, g)
            for i in range(n):
                for j in active:
                    linear[i] += M[i, at + j] * d0[j] + M[i, at + P + j] * d1[j]
            for j in active:
                add_to_port(step, tangent, L, j, 1.0, 0.0, d0[j], D0, j)
                add_to_port(step, tangent, L, j, 0.0, 1.0, d1[j], D1, j)
            for e in range(K):
                effect = step.effects[e]
                if not effect.implicit:
                    continue
                port = effect.port
                s[0] = observe(H, effect.signal_0, linear, end, d1, active)
                observe_rows(step, tangent, effect.signal_0, linear, end, d1, L, U1, D1, spare,
                             SIGNAL)
                clear(spare, BEFORE)
                added = linearise(step, tangent, e, 0.0, s, z, h, tangent.compliance[e], z_next,
                                  Z, Z_next, spare, g)
                for i in range(n):
                    linear[i] += (M[i, at + port] + M[i, at + P + port]) * added
                add_to_port(step, tangent, L, port, 1.0, 1.0, added, spare, AFTER)
                z_next[kept + e] = added
                put(Z_next, kept + e, 1.0, spare, AFTER)
            for i in range(W):
                z[i] = z_next[i]
                put(Z, i, 1.0, Z_next, i)
        for i in range(n):
            x[i] = linear[i]
            put(X, i, 1.0, L, i)


@compiled
def output(step, tangent, x, z, work, rows, g, inputs, k, dy):  # type: ignore[no-untyped-def]
    """Return the output at sample k and write its derivatives into dy (D,)."""
    X, Z, _, U, _, D, _, _, Z_next, spare = rows
    m, n, W = len(step.shift), len(x), len(z)
    P = step.H.shape[1] - n - m
    u, d = work[1, :m], work[5, :P]
    for j in range(m):
        u[j] = inputs[k, j]
        clear(U, j)
        if step.shift[j] > 0.0:
            u[j] = interpolated(inputs, j, k, 1.0 - step.shift[j])
            put(U, j, -slope_at(inputs, j, k, 1.0 - step.shift[j]), tangent.shift, j)
    if len(step.active) > 0:
        add_effects(step, tangent, x, u, z, 0.0, work[7], work[6, :W], d, X, U, D, Z, Z_next,
                    spare, g)
    observe_rows(step, tangent, P - 1, x, u, d, X, U, D, spare, BEFORE)
    add(spare, BEFORE, 1.0, D, P - 1)
    for q in range(len(dy)):
        dy[q] = spare[BEFORE, q // WIDTH, q % WIDTH]
    return observe(step.H, P - 1, x, u, d, step.active) + d[P - 1]


@compiled
def read_sensor(step, tangent, row, x, z, work, rows, dy):  # type: ignore[no-untyped-def]
    """Return what the sensor in a row of H reads, after `output`; its derivatives go to dy."""
    X, Z, _, U, _, D, _, _, _, spare = rows
    n, m, kept = len(x), len(step.shift), len(z) - len(step.effects)
    u, d = work[1, :m], work[5, :step.H.shape[1] - n - m]
    observe_rows(step, tangent, row, x, u, d, X, U, D, spare, BEFORE)
    for e in range(len(step.effects)):
        if step.effects[e].implicit:
            column = n + m + step.effects[e].port
            if step.H[row, column] != 0.0:
                add(spare, BEFORE, step.H[row, column], Z, kept + e)
            if tangent.moves[row, column]:
                add(spare, BEFORE, z[kept + e], tangent.H, row * step.H.shape[1] + column)
    for q in range(len(dy)):
        dy[q] = spare[BEFORE, q // WIDTH, q % WIDTH]
    return kernel.read_sensor(step, row, x, z, u, d)


@compiled
def run(  # type: ignore[no-untyped-def]
        step, tangent, x, z, work, rows, g, inputs, sensors, y, dy, first, last):
    """Fill y (1 + K, N) with output and sensors, dy (1 + K, N, D) with their derivatives.

    At first <= k < last; `sensors` are rows of H, (K,). x, z and rows are those of the sample
    before the first, and are moved. A run that diverges is left at nan from there on, its
    derivatives at 0.
    """
    for k in range(first, last):
        if k > 0:
            advance(step, tangent, x, z, work, rows, g, inputs, k)
        y[0, k] = output(step, tangent, x, z, work, rows, g, inputs, k, dy[0, k])
        if not abs(y[0, k]) < LIMIT:
            y[:, k:] = float('nan')
            dy[:, k:] = 0.0
            return
        for q in range(len(sensors)):
            y[1 + q, k] = read_sensor(step, tangent, sensors[q], x, z, work, rows, dy[1 + q, k])


def run_with_slopes(system: System, by: Directions, tangents: Sequence[Tangent],
                    inputs: FloatArray, x: FloatArray, z: FloatArray, start: int | None = None
                    ) -> tuple[FloatArray, FloatArray]:
    """Run freely as `run_all_with_slopes`; returns the output (N,) and its derivatives (N, D)."""
    y, slopes = run_all_with_slopes(system, by, tangents, inputs, x, z, start)
    return y[0], slopes[0]


def run_all_with_slopes(
    system: System, by: Directions, tangents: Sequence[Tangent], inputs: FloatArray,
    x: FloatArray, z: FloatArray, start: int | None = None, sensors: Sequence[str] = (),
) -> tuple[FloatArray, FloatArray]:
    """Run freely from state x (n,) and memory z, with derivatives.

    Args:
        system: what is run.
        by: the unknowns.
        tangents: of each of its stages by these and by the state at the start, see `tangent_of`.
        inputs: (N, m).
        x: the state at the start, (n,).
        z: what the effects keep there, (memory,).
        start: stamp of the first sample [ns]; None stands for now.
        sensors: names of K that are wanted beside the output.

    Returns:
        Output and sensors, (1 + K, N), and their derivatives, (1 + K, N, D): by the unknowns, by x
        and by z. Zero for what does not last, and for what grows without bound, as under laws
        that are not stable.
    """
    n, kept = len(x), lasting(system)
    columns = np.zeros((n + system.memory, by.count + n + len(kept)))
    columns[:n, by.count:by.count + n] = np.eye(n)
    columns[n + kept, by.count + n:] = np.eye(len(kept))
    blocks = in_rows(columns)
    rows = rows_for(system, blocks.shape[1])
    rows.X[:], rows.Z[:] = blocks[:n], blocks[n:]
    g = partials(system)
    outputs, N = 1 + len(sensors), len(inputs)
    y, dy = np.empty((outputs, N)), np.empty((outputs, N, columns.shape[1]))
    x, z, stages, read = x.copy(), z.copy(), system.stages, system.sensor_rows(sensors)
    for k, first, last in system.stretches(len(inputs), start):
        run(stages[k].step, tangents[k], x, z, system.work(), rows, g, inputs, read, y, dy, first,
            last)
        if math.isnan(y[0, last - 1]):
            break
    dy[..., ~(np.abs(dy).max(axis=(0, 1)) < UNBOUNDED)] = 0.0
    if len(kept) == system.memory:
        return y, dy
    slopes = np.zeros((outputs, N, by.count + n + system.memory))
    slopes[..., :by.count + n] = dy[..., :by.count + n]
    slopes[..., by.count + n + kept] = dy[..., by.count + n:]
    return y, slopes
