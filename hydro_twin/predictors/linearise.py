"""Linearisation of the laws of effects: by derivatives at a point, or over an uncertain input.

An observer knows the input of a law only up to its uncertainty. Near a kink, the slope at the
estimate is that of one side. On average, the mean value and the mean slope over the distribution
are right, with the residual about that line: statistical linearisation [Gelb 1974, ch. 6].
"""
from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np

from hydro_twin.compiled import generated, not_inlined
from hydro_twin.effects.differentiate import NoTangent
from hydro_twin.effects.dispatch import call, LAWS
from hydro_twin.effects.rules import PRELUDE
from hydro_twin.effects.tangent import law_differences, law_tangent, WEIGH

NAME = 'hydro_twin_tangents'
# A normal distribution on seven points, 0.8 standard deviations apart: enough that the mean slope
# of a step is smooth in where it lies. The two outermost come first.
POINTS = np.array([2.4, -2.4, 0.0, 0.8, -0.8, 1.6, -1.6])
WEIGHTS = np.exp(-0.5 * POINTS ** 2) / np.exp(-0.5 * POINTS ** 2).sum()
BENT = 0.01             # of what a law moves by over them: what bends less counts as straight


def source() -> str:
    """Write the module of the laws' derivatives.

    A law whose source cannot be differentiated has its derivatives by differences.
    """
    imports = ['from hydro_twin.compiled import not_inlined']
    functions, branches = [PRELUDE, WEIGH], []
    for k, (module, law) in enumerate(LAWS):
        if law is None:
            continue
        name = f'tangent_{k}'
        try:
            functions.append(law_tangent(law, name))
        except (NoTangent, OSError, SyntaxError):
            imports.append(f'from {module} import law as law_{k}')
            functions.append(law_differences(f'law_{k}', name))
        branches.append(f'    if code == {k}:\n        return {name}(v, s, p, z, h, c, z_next, g)')
    head = '\n\n\n@not_inlined\ndef differentiate(code, v, s, p, z, h, c, z_next, g):'
    return '\n'.join([*imports, ''.join(functions).rstrip('\n') + head, *branches,
                      '    return v', ''])


# The value of a law; g (1 + memory, 4 + parameters + memory) gets the derivatives of value and
# memory by the value that reaches it, both signals, compliance, parameters and memory.
differentiate: Callable[..., Any] = generated(NAME, source).differentiate


@not_inlined
def straight(code, v, s, p, z, h, c, z_next, g, value, dv, ds):  # type: ignore[no-untyped-def]
    """Say whether a law with this value and derivatives g is straight over the distribution."""
    at, slope, reach = s[0], g[0, 0] * dv + g[0, 1] * ds, POINTS[0]
    s[0] = at + reach * ds
    up = call(code, v + reach * dv, s, p, z, h, c, z_next) - value
    s[0] = at - reach * ds
    down = call(code, v - reach * dv, s, p, z, h, c, z_next) - value
    s[0] = at
    bend = max(abs(up - reach * slope), abs(down + reach * slope))
    return bend <= BENT * max(abs(up), abs(down))


@not_inlined
def average(code, v, s, p, z, h, c, z_next, g, total, dv, ds):  # type: ignore[no-untyped-def]
    """Average a law, its derivatives and the memory it leaves over a normal distribution.

    One standard deviation moves the value by dv and the first signal by ds; total is scratch, one
    column wider than g. Returns the mean of the value, and the standard deviation of its residual
    about the fitted line.
    """
    rows, columns, at = 1 + len(z), 4 + len(p) + len(z), s[0]
    mean = square = 0.0
    total[:] = 0.0
    for q in range(len(POINTS)):
        s[0] = at + POINTS[q] * ds
        value = differentiate(code, v + POINTS[q] * dv, s, p, z, h, c, z_next, g)
        mean += WEIGHTS[q] * value
        square += WEIGHTS[q] * value * value
        for i in range(rows):
            for j in range(columns):
                total[i, j] += WEIGHTS[q] * g[i, j]
        for i in range(len(z)):
            total[i, columns] += WEIGHTS[q] * z_next[i]
    s[0] = at
    for i in range(rows):
        for j in range(columns):
            g[i, j] = total[i, j]
    for i in range(len(z)):
        z_next[i] = total[i, columns]
    slope = g[0, 0] * dv + g[0, 1] * ds
    return mean, math.sqrt(max(square - mean * mean - slope * slope, 0.0))
