"""A few stretches of a long recording, enough to fit and to tell effects apart."""
from __future__ import annotations

from collections.abc import Sequence

from hydro_twin.fitting.candidate import Part, START

ENOUGH = 8_000          # scored samples
STRETCH = 1_500         # samples, with those that only set the state


def excerpt(parts: Sequence[Part]) -> list[Part]:
    """Cut stretches evenly out of parts that hold more samples than it takes.

    What is chosen does not depend on the output, so that it cannot favour a model.
    """
    if sum(len(part.measured) - START for part in parts) <= ENOUGH:
        return list(parts)
    total = sum(len(part.measured) for part in parts)
    cut = []
    for part in parts:
        n = len(part.measured)
        count = max(1, round(ENOUGH / (STRETCH - START) * n / total))
        length = min(STRETCH, n)
        for k in range(count):
            begin = (n - length) * (2 * k + 1) // (2 * count)
            cut.append(Part(part.inputs[begin:begin + length],
                            part.measured[begin:begin + length], part.source))
    return cut[::max(1, len(cut) * (STRETCH - START) // (2 * ENOUGH))]
