"""Coloured noise as an autoregressive process, and the filters that whiten it."""
from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
import scipy
from scipy import linalg, ndimage

from hydro_twin.arrays import FloatArray
from hydro_twin.predictors.scores import rms

ORDER = 6               # of the autoregression: three resonances, or filters of second order


def autoregression(stretches: Sequence[FloatArray], order: int = ORDER) -> FloatArray:
    """Fit an autoregressive model (Yule-Walker); returns the whitening filter [1, a1, ...]."""
    correlation = np.array([sum(r[lag:] @ r[:max(len(r) - lag, 0)] for r in stretches)
                            for lag in range(order + 1)])
    if correlation[0] <= 0.0:
        return np.concatenate([[1.0], np.zeros(order)])
    correlation[0] *= 1.0 + 1e-9
    a = linalg.solve_toeplitz(correlation[:-1], correlation[1:])
    return np.concatenate([[1.0], -a])


def filtered(filter_: FloatArray, columns: FloatArray) -> FloatArray:
    """Filter columns (N, ...), zero before the first sample, by [b0, b1, ...]."""
    found: FloatArray = ndimage.convolve1d(columns, filter_, axis=0, mode='constant',
                                           origin=-(len(filter_) // 2))
    return found


def whiten(stretches: Sequence[FloatArray], filter_: FloatArray) -> FloatArray:
    """Filter every stretch and join them, without the samples that lack a past."""
    cut = len(filter_) - 1
    return np.concatenate([filtered(filter_, r)[cut:] for r in stretches])


def noise_filter(stretches: Sequence[FloatArray]) -> FloatArray:
    """Return the filter that whitens a residual, scaled so that its RMS stays the same."""
    filter_ = autoregression(stretches)
    white = whiten(stretches, filter_)
    if not len(white):      # all are shorter than the filter
        return filter_
    return filter_ * (rms(np.concatenate(stretches)) / max(rms(white), 1e-300))


def effective_samples(stretches: Sequence[FloatArray]) -> float:
    """Return how many independent samples have a mean square as accurate as that of a residual.

    N / (1 + 2 sum of squared autocorrelations) [Bartlett 1946], over lags up to a quarter of the
    longest stretch, corrected for the scatter of the estimated autocorrelations, so that it is N
    for white noise.
    """
    lags = max(map(len, stretches)) // 4
    products, counts = np.zeros(lags + 1), np.zeros(lags + 1)
    for r in stretches:
        reach = min(lags + 1, len(r))
        both_ways = scipy.signal.correlate(r, r, method='fft')
        products[:reach] += both_ways[len(r) - 1:len(r) - 1 + reach]
        counts[:reach] += len(r) - np.arange(reach)
    if not products[0] > 0.0:
        return float(counts[0])
    squares, scatter = (products[1:] / products[0])**2, counts[1:] / counts[0]**2
    return float(counts[0] * min((1.0 + 2.0 * scatter.sum()) / (1.0 + 2.0 * squares.sum()), 1.0))


def effective_gain(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Twice the gain of the log-likelihood, with the effective number of samples of the latter."""
    a, b = (rms(np.concatenate(pieces))**2 for pieces in (before, after))
    return effective_samples(after) * math.log(max(a, 1e-300) / max(b, 1e-300))
