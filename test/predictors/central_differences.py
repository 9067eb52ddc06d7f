"""Differences of whole runs, that derivatives are checked against."""
from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hydro_twin.arrays import FloatArray


def differences(run: Callable[[FloatArray], FloatArray], at: FloatArray, steps: Sequence[float]
                ) -> tuple[FloatArray, FloatArray]:
    """Take central differences; also how far they change with the step, which kinks do."""
    columns = []
    for i, step in enumerate(steps):
        unit = step * np.eye(len(at))[i]
        wide, narrow = ((run(at + k * unit) - run(at - k * unit)) / (2 * k * step)
                        for k in (1.0, 0.25))
        columns.append((narrow, np.abs(wide - narrow)))
    slopes, changes = (np.stack(some, axis=1) for some in zip(*columns, strict=True))
    return slopes, changes
