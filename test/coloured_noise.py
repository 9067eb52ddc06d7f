"""Noise whose process is known."""
import numpy as np
from scipy.signal import lfilter


def coloured(seed, samples, memory, size=1.0):
    """AR(1) of a given RMS."""
    e = np.random.default_rng(seed).standard_normal(samples + 200)
    return size * np.sqrt(1 - memory**2) * lfilter([1.0], [1.0, -memory], e)[200:]
