"""Derivatives of what the law of an effect gives, by the chain rule."""
from __future__ import annotations

import math

from hydro_twin.compiled import inlined
from hydro_twin.predictors.linearise import average, differentiate, straight
from hydro_twin.predictors.rows import add, clear, WIDTH

# The rows of `Rows.spare`: the value that reaches an effect, the two signals it reads, what it
# gives.
BEFORE, SIGNAL, AFTER = 0, 1, 3
SPARE = 4


@inlined
def differentiate_law(step, e, v, s, z, h, c, z_next, g):  # type: ignore[no-untyped-def]
    """Return what the law of effect e gives, with its partial derivatives in g[0]."""
    effect = step.effects[e]
    p, first, last = step.p[effect.p_begin:effect.p_end], effect.z_begin, effect.z_end
    return differentiate(effect.code, v, s, p, z[first:last], h, c, z_next[first:last],
                         g[0, :1 + last - first, :4 + len(p) + last - first])


@inlined
def reads(step, tangent, e, column, usual, g):  # type: ignore[no-untyped-def]
    """Whether what an effect adds depends on the value that reaches it, or on a signal.

    That is a column of the partial derivatives; `usual` is what it is where nothing is added.
    """
    effect = step.effects[e]
    depends = tangent.rest >= 0 or g[0, 0, column] != usual
    for i in range(effect.z_end - effect.z_begin):
        depends = depends or g[0, 1 + i, column] != 0.0
    return depends


@inlined
def linearise(  # type: ignore[no-untyped-def]
        step, tangent, e, v, value, s, z, h, c, z_next, spare, g, out, row):
    """Linearise a law statistically; the derivatives in spare are square roots of covariances.

    Returns the mean of its value where the law is curved, else `value`, that at the estimate. The
    residual standard deviation of the linear fit is added to a column of its own in a row of out.
    """
    effect = step.effects[e]
    p, first, last = step.p[effect.p_begin:effect.p_end], effect.z_begin, effect.z_end
    own, kept = z[first:last], z_next[first:last]
    used = g[0, :1 + last - first, :4 + len(p) + last - first]
    read = SIGNAL if effect.signal_0 >= 0 else BEFORE
    square = product = beside = 0.0
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
    q = tangent.rest + e
    out[row, q // WIDTH, q % WIDTH] += beside
    return value


@inlined
def add_chain(  # type: ignore[no-untyped-def]
        step, tangent, e, usual, Z, Z_next, spare, g, out, row):
    """Add the derivatives of what effect e adds to a row of out, and write those of its memory.

    `usual` is what the derivative by the value that reaches it would be if it added nothing.
    """
    effect = step.effects[e]
    g[0, 0, 0] -= usual
    for i in range(1 + effect.z_end - effect.z_begin):
        if i > 0:
            out, row = Z_next, effect.z_begin + i - 1
            clear(out, row)
        chain(g[0, i], step, tangent, e, Z, spare, out, row)


@inlined
def chain(g, step, tangent, e, Z, spare, out, i):  # type: ignore[no-untyped-def]
    """Add to a row of out what follows from the partial derivatives g of effect e."""
    effect = step.effects[e]
    for k in range(3):
        if g[k] != 0.0:
            add(out, i, g[k], spare, k)
    if g[3] != 0.0:
        add(out, i, g[3], tangent.d_compliance, e)
    for k in range(effect.p_begin, effect.p_end):
        if g[4 + k - effect.p_begin] != 0.0:
            add(out, i, g[4 + k - effect.p_begin], tangent.p, k)
    at = 4 + effect.p_end - effect.p_begin
    for k in range(effect.z_begin, effect.z_end):
        if g[at + k - effect.z_begin] != 0.0:
            add(out, i, g[at + k - effect.z_begin], Z, k)
