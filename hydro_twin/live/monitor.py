"""Does the model still hold: watches the residual for a lasting rise, and for colour.

The innovation of an observer whose model holds is white. So in that mode its autocorrelation is
watched, too, beside its level.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

import numpy as np
from scipy.optimize import brentq

from hydro_twin.live.location import Location

RISE = 1.2              # the rise of the residual's RMS that is to be found
FALSE_ALARM = 10 * 86400.0   # mean time between false alarms [s]: a tenth of an alarm a day
BATCH = 1.0             # length of the shortest batch [s]
LEARN = 16384           # samples from which the colour of the residual is learned
FREEDOM = 30.0          # least degrees of freedom of a batch, for its cube root to be normal
LOW = 8                 # lowest frequencies from which the variance of a batch is taken
SAFETY = 2.0            # upper 95 % limit of a variance known from `LOW` of them
LAGS = 10               # at which the innovation's autocorrelation is watched
COLOUR_REFERENCE = 1.0  # reference of that watch, in standard deviations of a batch's statistic
OVERSHOOT = 1.166       # of a normal random walk over two boundaries [Siegmund 1985]


@dataclass(frozen=True)
class Chart:
    """A one-sided CUSUM of normal variables, made for one rise and one rate of false alarms.

    Attributes:
        samples: samples in a batch.
        freedom: degrees of freedom of the mean square of a batch.
        reference: half the rise, in standard deviations of a batch.
        threshold: alarm above this.
        delay: mean time from a rise by `RISE` to the alarm [s].
    """

    samples: int
    freedom: float
    reference: float
    threshold: float
    delay: float

    def score(self, ratio: float) -> float:
        """Turn mean square over the reference into a standard normal variable."""
        return normal_score(ratio, self.freedom)


def normal_score(ratio: float, freedom: float) -> float:
    """Turn a chi-square variable over its mean into a standard normal one.

    Its cube root is nearly normal [Wilson and Hilferty 1931].
    """
    spread = 2.0 / (9.0 * freedom)
    return (math.cbrt(ratio) - (1.0 - spread)) / math.sqrt(spread)


def design(variance: float, sample_time: float) -> Chart:
    """Choose batch and threshold for a residual of a given colour.

    Args:
        variance: n Var(m) / E(m)^2 of the mean m of n squared samples; 2 when white.
        sample_time: [s].

    Returns:
        The chart. Run lengths are Siegmund's, (e^-c + c - 1) / (2 k^2) with c = 2 k b in a drift
        k towards the boundary b = threshold + 1.166, and the same with -c away from it.
    """
    samples = math.ceil(max(BATCH / sample_time, FREEDOM * variance / 2.0))
    freedom = 2.0 * samples / variance
    k = 0.5 * (math.cbrt(RISE**2) - 1.0) / math.sqrt(2.0 / (9.0 * freedom))
    batch = samples * sample_time
    wanted = max(FALSE_ALARM / batch, 10.0)

    threshold = max(threshold_of(k, wanted), k)
    c = 2.0 * k * (threshold + OVERSHOOT)
    delay = max((math.exp(-c) + c - 1.0) / (2.0 * k * k), 1.0) * batch
    return Chart(samples, freedom, k, threshold, delay)


def threshold_of(reference: float, batches: float) -> float:
    """Find the threshold of a one-sided CUSUM of normal variables [Siegmund 1985].

    Args:
        reference: the reference value k, subtracted from each variable [standard deviations].
        batches: mean number of them between two false alarms.
    """
    def excess(c: float) -> float:
        return (math.exp(c) - c - 1.0) / (2.0 * reference * reference) - batches

    c: float = brentq(excess, 1e-9, math.log(batches * 2.0 * reference * reference + 1.0) + 10.0)
    return c / (2.0 * reference) - OVERSHOOT


def relative_long_run_variance(residual: np.ndarray) -> float:
    """Estimate the variance of the mean squared residual, whatever the residual's colour.

    It is taken from the lowest frequencies of the periodogram of the squares, which give the
    variance of long batch means. It is an upper limit, so that colour that is hard to detect
    causes no false alarms.

    Args:
        residual: shape (n,), in any unit.

    Returns:
        n Var(m) / E(m)^2 of the mean m of n squares; 2 when the residual is white and normal.
    """
    squares = residual * residual
    mean = float(squares.mean())
    if mean == 0.0:
        return 2.0
    low = np.abs(np.fft.rfft(squares - mean)[1:LOW + 1])**2 / len(squares)
    return max(SAFETY * float(low.mean()) / mean**2, 2.0)


@dataclass(frozen=True)
class Rise:
    """A lasting rise of the residual, with the stretch that shows it.

    Attributes:
        sign: 'level' or 'colour': what no longer is as it was.
        begin, end: stamps of the stretch [ns].
        settled: end of the first batch of the stretch [ns]: the rise began between `begin` and
            this.
        rms: RMS of the residual, as measured [unit of the output].
        reference_rms: the same as the model file states it for held-out data.
        location: where the fault enters; None where that is not looked for.
    """

    begin: int
    settled: int
    end: int
    rms: float
    reference_rms: float
    sign: str = 'level'
    location: Location | None = None


class WhitenessCusum:
    """A one-sided CUSUM of the autocorrelation, batch by batch [Ljung and Box 1978].

    The statistic of a white batch is a chi-square variable of `LAGS` degrees of freedom, made
    nearly normal by its cube root. What the first batches have counts as usual: a model that never
    was white is found by its level.

    Attributes:
        share: of the mean square of the last batch that its past predicts.
    """

    def __init__(self, batch: float) -> None:
        """Watch batches of so many seconds, for one false alarm in `FALSE_ALARM`."""
        self.share = math.nan
        self._usual: list[float] = []
        self._cusum = 0.0
        self._threshold = threshold_of(COLOUR_REFERENCE, FALSE_ALARM / batch)

    @property
    def rising(self) -> bool:
        """Whether the last batches were more coloured than usual."""
        return self._cusum > 0.0

    def take(self, residuals: np.ndarray, learning: bool) -> bool:
        """Take in a batch; returns whether the colour is more than usual by now."""
        n = len(residuals)
        e = residuals - residuals.mean()
        square = float(e @ e)
        if square == 0.0:
            return False
        rho = np.array([float(e[k:] @ e[:-k]) for k in range(1, LAGS + 1)]) / square
        statistic = n * (n + 2.0) * float(np.sum(rho ** 2 / (n - np.arange(1, LAGS + 1))))
        self.share = max(statistic - LAGS, 0.0) / n
        if learning:
            self._usual.append(statistic)
            return False
        usual = max(float(np.mean(self._usual or [LAGS])), LAGS)
        score = normal_score(statistic / usual, LAGS)
        self._cusum = max(0.0, self._cusum + score - COLOUR_REFERENCE)
        return self._cusum > self._threshold


class Monitor:
    """Watches the residual of one twin.

    `add` is for the hot path and only sums; `judge` does the thinking and may run in another
    thread. The colour of the residual is learned from the first `LEARN` samples; its level is
    compared with that of the model file, so that a model which never held is found too.
    """

    def __init__(self, reference_rms: float, sample_time: float, white: bool = False) -> None:
        """Watch a residual.

        Args:
            reference_rms: RMS that it had on held-out data [unit of the output].
            sample_time: [s].
            white: whether its colour is watched, too: that of an observer.
        """
        self.reference_rms = reference_rms
        self.sample_time = sample_time
        self.chart: Chart | None = None
        self.rise: Rise | None = None
        self._base = max(round(BATCH / sample_time), 1)     # samples of a batch
        self.colour = WhitenessCusum(BATCH) if white and self._base > 3 * LAGS else None
        self._kept = np.empty(self._base)
        self._series: deque[tuple[int, int, np.ndarray]] = deque(maxlen=3600)
        self._judged = 0
        self._onset_of_colour = 0, 0
        self._seen = np.empty(LEARN)
        self._learned = 0
        self._batches: deque[tuple[int, int, float, int]] = deque(maxlen=3600)
        self._begin = 0
        self._sum = 0.0
        self._count = 0
        self._pool = (0, 0.0, 0)
        self._cusum = 0.0
        self._onset = 0, 0
        self.rms = math.nan

    def add(self, stamp: int, residual: float) -> None:
        """Take in the residual of the sample at a stamp [ns]."""
        if self._learned < LEARN:
            self._seen[self._learned] = residual
            self._learned += 1
        if not self._count:
            self._begin = stamp
        self._sum += residual * residual
        if self.colour is not None:
            self._kept[self._count] = residual
        self._count += 1
        if self._count == self._base:
            if self.colour is not None:
                self._series.append((self._begin, stamp, self._kept.copy()))
            self._batches.append((self._begin, stamp, self._sum, self._count))
            self._sum, self._count = 0.0, 0

    def judge(self) -> Rise | None:
        """Work through the batches that are full.

        Returns:
            The rise when it has just been found; afterwards it stays in `rise`.
        """
        if self.chart is None:
            if self._learned < LEARN:
                return None
            self.chart = design(relative_long_run_variance(self._seen), self.sample_time)
        found = None
        while self._batches:
            found = self._take(self.chart, *self._batches.popleft()) or found
        return self._judge_colour() or found

    def _judge_colour(self) -> Rise | None:
        """Work through the batches whose colour is watched."""
        found = None
        while self.colour is not None and self._series:
            begin, end, residuals = self._series.popleft()
            self._judged += 1
            if not self.colour.rising:
                self._onset_of_colour = begin, end
            alarm = self.colour.take(residuals, self._judged * self._base <= LEARN)
            if alarm and self.rise is None:
                self.rise = found = Rise(*self._onset_of_colour, end, self.rms, self.reference_rms,
                                         'colour')
        return found

    def _take(self, chart: Chart, begin: int, end: int, total: float, count: int) -> Rise | None:
        """Add a short batch to the pool, and step the CUSUM when that is a batch of the chart."""
        start, pooled, number = self._pool
        if not number:
            start = begin
        self._pool = (start, pooled + total, number + count)
        if self._pool[2] < chart.samples:
            return None
        mean_square = self._pool[1] / self._pool[2]
        self._pool = (0, 0.0, 0)
        self.rms = math.sqrt(mean_square)
        if self._cusum == 0.0:
            self._onset = start, end
        score = chart.score(mean_square / self.reference_rms**2)
        self._cusum = max(0.0, self._cusum + score - chart.reference)
        if self.rise is None and self._cusum > chart.threshold:
            self.rise = Rise(*self._onset, end, self.rms, self.reference_rms)
            return self.rise
        return None
