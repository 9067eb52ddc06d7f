"""The length of the blocks of a bootstrap, from the memory of what is drawn."""
from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from hydro_twin.plants.plant import FloatArray


def block_length(stretches: Sequence[FloatArray]) -> int:
    """Choose how many samples make a block, so that the mean of blocks has the right variance.

    By the correlation of the samples, up to the lag from which it cannot be told from zero, under
    a flat-top window [Politis and White 2004; corrected in Patton, Politis and White 2009].

    Args:
        stretches: of what is averaged, one after another without a link between them.
    """
    N = sum(map(len, stretches))
    mean = sum(float(np.sum(one)) for one in stretches) / N
    centred = [one - mean for one in stretches]
    run = max(5, math.ceil(math.sqrt(math.log10(N))))       # lags without correlation that end it
    most = math.ceil(math.sqrt(N)) + run
    R = np.array([sum(float(one[:len(one) - lag] @ one[lag:]) for one in centred) / N
                  for lag in range(min(2 * most + 1, *map(len, centred)))])
    if R[0] <= 0.0:
        return 1
    small = np.abs(R) < 2.0 * math.sqrt(math.log10(N) / N) * R[0]
    last = next((lag for lag in range(len(R) - run) if small[lag + 1:lag + 1 + run].all()), most)
    M = min(2 * max(last, 1), len(R) - 1)
    lag = np.arange(-M, M + 1)
    weighted = np.minimum(1.0, 2.0 * (1.0 - np.abs(lag) / M)) * R[np.abs(lag)]
    spread = float(weighted.sum())
    longest = math.ceil(min(3.0 * math.sqrt(N), N / 3.0))
    if spread <= 0.0:
        return longest
    best = math.cbrt(1.5 * N * (float(weighted @ np.abs(lag)) / spread) ** 2)
    return max(1, min(round(best), longest))
