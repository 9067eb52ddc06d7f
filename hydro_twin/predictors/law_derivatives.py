"""Derivatives of what the law of an effect gives, by the chain rule."""
from __future__ import annotations

import math

from hydro_twin.compiled import inlined
from hydro_twin.predictors.linearise import average, differentiate, straight
from hydro_twin.predictors.rows import add, put, WIDTH

# The rows of `Rows.spare`: value before and after an effect, and the two signals it reads.
BEFORE, AFTER, SIGNAL = 0, 1, 2
SPARE = 4


@inlined
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


@inlined
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
