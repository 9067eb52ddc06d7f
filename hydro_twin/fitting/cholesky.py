"""The solution of small normal equations, compiled."""
from __future__ import annotations

import numpy as np

from hydro_twin.compiled import compiled


@compiled
def solve_cholesky(normal, right, ridge):  # type: ignore[no-untyped-def]
    """Solve symmetric equations (c, c), given below the diagonal, in place by Cholesky's factor.

    With a ridge on the diagonal, which bounds what rounding may leave of it. The right sides,
    (c, R), become the solutions.
    """
    c = len(normal)
    for a in range(c):
        normal[a, a] += ridge
        for b in range(a + 1):
            for j in range(b):
                normal[a, b] -= normal[a, j] * normal[b, j]
            if b < a:
                normal[a, b] /= normal[b, b]
        normal[a, a] = np.sqrt(max(normal[a, a], ridge))
    for r in range(right.shape[1]):
        for a in range(c):
            for b in range(a):
                right[a, r] -= normal[a, b] * right[b, r]
            right[a, r] /= normal[a, a]
        for a in range(c - 1, -1, -1):
            for b in range(a + 1, c):
                right[a, r] -= normal[b, a] * right[b, r]
            right[a, r] /= normal[a, a]
