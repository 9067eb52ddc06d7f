"""Rules of differentiation, as pieces of code: for operators and functions of numbers.

At a kink the derivative is one-sided: abs has that of rising from 0, min and max that of their
first argument where both are equal, and a branch that of the side that the condition takes. A
power of zero with an infinite slope has the slope 0.
"""
from __future__ import annotations

import ast

# Functions whose result counts as constant.
INACTIVE = {'int', 'len', 'range', 'round', 'math.isinf', 'math.isnan', 'math.floor',
            'math.ceil'}
# result r of operands a and b -> partial derivatives by each
BINARY: dict[type[ast.operator], tuple[str, str, str]] = {
    ast.Add: ('{a} + {b}', '1.0', '1.0'),
    ast.Sub: ('{a} - {b}', '1.0', '-1.0'),
    ast.Mult: ('{a} * {b}', '{b}', '{a}'),
    ast.Div: ('{a} / {b}', '1.0 / {b}', '-{r} / {b}'),
    ast.Pow: ('{a} ** {b}', 'by_base({a}, {b})', 'by_exponent({a}, {r})'),
}
FUNCTIONS: dict[str, tuple[str, ...]] = {
    'min': ('1.0 if {a} <= {b} else 0.0', '0.0 if {a} <= {b} else 1.0'),
    'max': ('1.0 if {a} >= {b} else 0.0', '0.0 if {a} >= {b} else 1.0'),
    'abs': ('1.0 if {a} >= 0.0 else -1.0',),
    'math.fabs': ('1.0 if {a} >= 0.0 else -1.0',),
    'math.copysign': ('math.copysign(1.0, {b}) * (1.0 if {a} >= 0.0 else -1.0)', '0.0'),
    'math.exp': ('{r}',),
    'math.log': ('1.0 / {a}',),
    'math.sqrt': ('0.5 / {r} if {r} > 0.0 else 0.0',),
    'math.sin': ('math.cos({a})',),
    'math.cos': ('-math.sin({a})',),
    'math.tan': ('1.0 + {r} * {r}',),
    'math.atan': ('1.0 / (1.0 + {a} * {a})',),
    'math.sinh': ('math.cosh({a})',),
    'math.cosh': ('math.sinh({a})',),
    'math.tanh': ('1.0 - {r} * {r}',),
    'math.hypot': ('{a} / {r} if {r} > 0.0 else 0.0', '{b} / {r} if {r} > 0.0 else 0.0'),
}
PRELUDE = """import math

from hydro_twin.compiled import compiled


@compiled
def by_base(a, b):
    return b * a ** (b - 1.0) if a != 0.0 or b >= 1.0 else 0.0


@compiled
def by_exponent(a, r):
    return r * math.log(a) if a > 0.0 else 0.0
"""
