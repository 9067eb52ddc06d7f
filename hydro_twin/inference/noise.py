"""What a residual looks like by itself: noise floor, memory, spectral lines, bursts."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.special import chdtri, gammainccinv

from hydro_twin.arrays import FloatArray
from hydro_twin.predictors.scores import rms
from hydro_twin.result import Line

BLOCK = 50              # samples of which the power is taken together, to see when it is large
BURST = 4.0             # power of such, over what three in four stay below, that is loud
MAX_BURST_TIME, MIN_BURST_POWER = 0.1, 0.4  # most time that bursts may take, least of the power
#                         they hold
MAX_COLOURED_NOISE_RATIO = 2.5  # ratio of error to noise floor up to which it may be coloured
#                         noise
ROUNDING = 1e-9         # of a residual
UPPER = 0.33            # of the sample rate: the upper third of a spectrum
LINES = 5               # that are reported at most: a person reads them
LEAST_SAMPLES = 200     # of a stretch in which lines are looked for: a spectrum has a level only
#                         if it is much wider than a line
LEVEL_WIDTH = 16        # resolutions on either side over which the level is the median: many, so
#                         that a line does not raise it, and few beside the width of coloured noise
P_LINES = 1e-3          # probability of a line in noise
LEVEL_MARGIN = 1.5      # ratio that is allowed for, since the level is an estimate
APART = 4.0             # resolutions, the width of a peak under the window: nearer ones are one
MIN_BLOCKS = 20         # fewer do not tell what is seldom


def noise_floor(stretches: Sequence[FloatArray]) -> float:
    """Estimate the RMS of the noise from the upper third of the residual's spectrum.

    There the plants pass next to nothing on; what is there is noise, taken as white down to zero.
    Where the noise is coloured this is not its whole RMS. Less than a billionth of the residual is
    rounding.
    """
    levels, weights = [], []
    for r in stretches:
        n = min(256, len(r))
        frequency, density = signal.welch(r, fs=1.0, nperseg=n, detrend='linear')
        upper = density[frequency > UPPER]
        levels.append(float(np.median(upper)) / 0.5 / _median_bias(len(r), n))
        weights.append(len(r))
    least = ROUNDING * rms(np.concatenate(stretches))
    return max(float(np.sqrt(np.average(levels, weights=weights) * 0.25)), least)


def cannot_be_noise(stretches: Sequence[FloatArray]) -> bool:
    """Whether a residual is larger than noise is, white or coloured."""
    return rms(np.concatenate(stretches)) > MAX_COLOURED_NOISE_RATIO * noise_floor(stretches)


def _median_bias(samples: int, segment: int) -> float:
    """Median over mean of a spectral estimate that averages this many half-covered segments."""
    segments = max(1, 2 * samples // segment - 1)
    freedom = 2.0 * max(1.0, segments * 9.0 / 11.0)         # Hann, half overlap [Welch 1967]
    return float(chdtri(freedom, 0.5) / freedom)


def lines(stretches: Sequence[FloatArray], sample_time: float) -> list[Line]:
    """Find frequencies that stand out of the spectrum of a residual.

    The periodogram of each stretch is divided by its own local level (a running median), so that
    coloured noise has no lines, and these ratios are summed over the stretches. In noise the sum
    has a gamma distribution; a line exceeds it by a margin, with a Bonferroni correction for all
    frequencies of all stretches.
    """
    long = [r for r in stretches if len(r) >= LEAST_SAMPLES]
    if not long:
        return []
    n = max(len(r) for r in long)
    size = 1 << (4 * n - 1).bit_length()
    frequency = np.fft.rfftfreq(size, sample_time)
    ratio = np.zeros(len(frequency))
    amplitude = np.zeros(len(frequency))
    for r in long:
        window = signal.windows.hann(len(r), sym=False)
        spectrum = np.abs(np.fft.rfft((r - r.mean()) * window, size)) ** 2
        width = LEVEL_WIDTH * size // len(r) | 1
        level = _running_median(spectrum, width) / np.log(2.0)
        ratio += spectrum / np.maximum(level, 1e-300)
        amplitude += 2.0 * np.sqrt(spectrum) / window.sum() / len(long)
    tests = n / 2 * len(long)
    threshold = gammainccinv(len(long), P_LINES / tests) * LEVEL_MARGIN
    found: list[Line] = []
    reach = APART / (min(len(r) for r in long) * sample_time)
    for k in np.argsort(ratio)[::-1]:
        if ratio[k] < threshold or len(found) == LINES:
            break
        if frequency[k] > reach and all(abs(frequency[k] - line.frequency) > reach
                                        for line in found):
            found.append(Line(float(frequency[k]), float(amplitude[k])))
    return sorted(found, key=lambda line: line.frequency)


def _running_median(values: FloatArray, width: int) -> FloatArray:
    """Median in a window of a few hundred bins, on a coarse grid, interpolated."""
    step = max(1, width // 4)
    centres = np.arange(0, len(values), step)
    medians = [np.median(values[max(0, c - width):c + width + 1]) for c in centres]
    return np.interp(np.arange(len(values)), centres, medians)


@dataclass(frozen=True)
class BurstSamples:
    """When much of a residual comes.

    Attributes:
        stretch: index of the stretch.
        begin, end: samples of it, begin <= k < end.
    """

    stretch: int
    begin: int
    end: int


def bursts(stretches: Sequence[FloatArray]) -> list[BurstSamples]:
    """Find when a residual comes, if four tenths of its power come in a tenth of the time or less.

    So it does where something happened once, and not where a law is lacking that acts all along,
    nor in noise, white or coloured.
    """
    blocks = [BurstSamples(index, begin, min(begin + BLOCK, len(r)))
              for index, r in enumerate(stretches) for begin in range(0, len(r), BLOCK)]
    if len(blocks) < MIN_BLOCKS:
        return []
    energy = np.array([float(np.sum(stretches[s.stretch][s.begin:s.end] ** 2)) for s in blocks])
    power = energy / [s.end - s.begin for s in blocks]
    loud = power > BURST * np.quantile(power, 0.75)
    if loud.mean() > MAX_BURST_TIME or energy[loud].sum() < MIN_BURST_POWER * energy.sum():
        return []
    found: list[BurstSamples] = []
    for k in np.flatnonzero(loud):
        if found and (found[-1].stretch, found[-1].end) == (blocks[k].stretch, blocks[k].begin):
            found[-1] = BurstSamples(blocks[k].stretch, found[-1].begin, blocks[k].end)
        else:
            found.append(blocks[k])
    return found
