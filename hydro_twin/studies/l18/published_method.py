"""The identification of [L18] as published: prefilter, scaling, a 5-1-1 network, its weights read.

The hidden unit is linear in its five inputs u(k-1), u(k-2), y(k-1), y(k-2), y(k-3), so that its
weights are those of a difference equation (11, 12); target and output pass a logistic (10).
"""
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter, lfiltic, sosfiltfilt
from scipy.special import expit

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Recording, Series
from hydro_twin.studies.l18.direct import Nearest, nearest_loop
from hydro_twin.studies.l18.linear_loop import LoopParameters, parameters_from_poles, Weights
from hydro_twin.studies.l18.networks import train_bp, train_rbf
from hydro_twin.studies.l18.printed_equation import parameters_as_printed

Reading = Callable[[Weights, float, float], LoopParameters]

TRAIN, TEST = 600, 100      # samples, in time order
LAGS = 3
PASS_HZ, STOP_HZ = 3.0, 20.0
PASSES = 20                 # over the training samples
MOMENTUM = 0.5
# From y(k) = y(k-1), since a large first error throws the weights where the logistic is flat.
START, START_SPREAD = np.array([0.0, 0.0, 1.0, 0.0, 0.0]), 1e-3
# Samples of a smooth signal are nearly collinear. With less, the weights stay where they began.
INITIAL_COVARIANCE = 1e14


@dataclass(frozen=True)
class Prepared:
    """The filtered window that the networks see, scaled to [0, 1].

    Attributes:
        past: u(k-1) to u(k-3), then y(k-1) to y(k-3), shape (samples - 3, 6).
        target: y(k), shape (samples - 3,).
        train: how many of them, from the first, train.
        low, high: what 0 and 1 stand for [1].
        sample_time: distance of two samples [s].
        raw: the opening of the window before the filter [1], shape (samples - 3,).
    """

    past: FloatArray
    target: FloatArray
    train: int
    low: float
    high: float
    sample_time: float
    raw: FloatArray

    @property
    def regressors(self) -> FloatArray:
        """The inputs of the network, u(k-1), u(k-2), y(k-1) to y(k-3), (samples - 3, 5)."""
        return self.past[:, [0, 1, 3, 4, 5]]

    @property
    def opening(self) -> FloatArray:
        """The filtered opening [1], shape (samples - 3,)."""
        return self.unscaled(self.target)

    def unscaled(self, scaled: FloatArray) -> FloatArray:
        """Take the scaling to [0, 1] back."""
        return self.low + (self.high - self.low) * scaled


@dataclass(frozen=True)
class PublishedFit:
    """What the published method found.

    Attributes:
        data: the window it was found on.
        weights: of the difference equation.
        printed: parameters by eq. 3 as printed, or why there are none.
        exact: parameters read from the poles, or why there are none.
        nearest: the loop that predicts most nearly what the weights predict.
        predicted: one-step prediction [1] of the 5-1-1 network, shape (samples - 3,).
        free_run: that network on its own past [1], the same shape; the test part starts again
            from the measured opening.
    """

    data: Prepared
    weights: Weights
    printed: LoopParameters | str
    exact: LoopParameters | str
    nearest: Nearest
    predicted: FloatArray
    free_run: FloatArray

    def errors(self, rivals: Mapping[str, FloatArray]) -> dict[str, dict[str, float]]:
        """RMS error of each network, in units of full opening, on both parts.

        Args:
            rivals: one-step predictions of other networks by name, see `predict_rivals`.
        """
        opening, train = self.data.opening, self.data.train
        runs = {'5-1-1': self.predicted, **rivals, '5-1-1 free run': self.free_run}
        return {name: {'train': rms(run[:train] - opening[:train]),
                       'test': rms(run[train:] - opening[train:])}
                for name, run in runs.items()}


def fit_published(recording: Recording, k_1: float, seed: int = 0) -> PublishedFit:
    """Identify the valve servo as [L18] does.

    Args:
        recording: with the signals command and opening.
        k_1: correction coefficient [1]; command and opening show only T_c / k_1.
        seed: of the network's starting weights.

    Raises:
        DataError: there are not 700 samples in one stretch, they come too slowly for the
            prefilter, or neither signal moves in them.
    """
    data = prepare(recording)
    X, y = data.regressors[:data.train], data.target[:data.train]
    weights = train_linear(X, y, np.random.default_rng(seed))
    # Both signals have one scale, and the steady gain is 1: the weights need no scaling back.
    v1, v2, n1, n2, n3 = weights.tolist()
    found = Weights((v1, v2), (n1, n2, n3))
    return PublishedFit(
        data=data,
        weights=found,
        printed=_parameters_or_reason(parameters_as_printed, found, data.sample_time, k_1),
        exact=_parameters_or_reason(parameters_from_poles, found, data.sample_time, k_1),
        nearest=nearest_loop(data.past[:data.train], X @ weights, data.sample_time, k_1),
        predicted=data.unscaled(data.regressors @ weights),
        free_run=data.unscaled(np.concatenate([
            _free_run(found, X), _free_run(found, data.regressors[data.train:])])),
    )


def predict_rivals(data: Prepared, seed: int = 0) -> dict[str, FloatArray]:
    """Train the networks that [L18] compares with, and predict the opening one step ahead.

    Returns:
        'rbf' and 'bp': predictions [1], shape (samples - 3,).
    """
    rng = np.random.default_rng(seed)
    X, y = data.regressors[:data.train], data.target[:data.train]
    return {name: data.unscaled(train(X, y, rng)(data.regressors))
            for name, train in (('rbf', train_rbf), ('bp', train_bp))}


def prepare(recording: Recording) -> Prepared:
    """Filter a recording, cut out its liveliest 700 samples and scale them [L18, (13)].

    The filter is a Butterworth low-pass of order 2, -3 dB at 3 Hz and -33 dB at 20 Hz, run
    forwards and backwards over the whole stretch, so that its ends lie outside the window where
    the stretch allows. One minimum and maximum, of both signals over the training part, scale
    both: with two, the difference equation would need a constant that the network lacks.

    Raises:
        DataError: see `fit_published`.
    """
    size = TRAIN + TEST
    long_enough = [series for series in recording.series if len(series) >= size]
    if not long_enough:
        longest = max((len(series) for series in recording.series), default=0)
        raise DataError(f'the published method takes {size} samples in one stretch; the longest '
                        f'has {longest}')
    windows = [_liveliest(prefiltered(series), size) for series in long_enough]
    series = max(windows, key=lambda window: float(np.var(window['command'])))
    u, y, raw = series['command'], series['opening'], series['raw']
    low = min(u[:TRAIN].min(), y[:TRAIN].min())
    high = max(u[:TRAIN].max(), y[:TRAIN].max())
    if not (np.ptp(u[:TRAIN]) > 1e-6 and np.ptp(y[:TRAIN]) > 1e-6):
        raise DataError(f'command or opening does not move in {series.source or "the recording"}:'
                        ' a step or a ramp of the command is needed')
    u, y = (u - low) / (high - low), (y - low) / (high - low)
    k = np.arange(LAGS, size)
    return Prepared(
        past=np.column_stack([signal[k - lag] for signal in (u, y)
                              for lag in range(1, LAGS + 1)]),
        target=y[k], train=TRAIN - LAGS, low=float(low), high=float(high),
        sample_time=series.sample_time, raw=raw[k])


def train_linear(X: FloatArray, y: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Train the 5-1-1 network by a recursive prediction error method with momentum.

    The gradient smoothed by the momentum, times the inverse of the recursively updated Hessian:
    S. Chen, C. F. N. Cowan, S. A. Billings, P. M. Grant, Int. J. Control 51 (1990) 1215-1228.

    Args:
        X: inputs, shape (samples, 5).
        y: scaled opening, shape (samples,); the target is its logistic.
        rng: draws the starting weights.

    Returns:
        The input weights v_1, v_2, n_1, n_2, n_3.
    """
    weights = START + START_SPREAD * rng.uniform(-1, 1, (X.shape[1],))
    P = np.eye(X.shape[1]) * INITIAL_COVARIANCE
    step = np.zeros_like(weights)
    target = expit(y)
    for _ in range(PASSES):
        for x, t in zip(X, target, strict=True):
            output = expit(x @ weights)
            psi = output * (1 - output) * x             # d output / d weights
            gain = P @ psi
            P -= np.outer(gain, gain) / (1 + psi @ gain)
            step = MOMENTUM * step + (1 - MOMENTUM) * (t - output) * psi
            weights = weights + P @ step
    return weights


def prefiltered(series: Series) -> Series:
    """Filter command and opening of a series, and keep the opening as `raw`; see `prepare`."""
    rate = 1 / series.sample_time
    if rate <= 2 * STOP_HZ:
        raise DataError(f'{series.source or "the recording"} has {rate:g} samples a second; the '
                        f'prefilter, with its stop band at {STOP_HZ:g} Hz, needs more than '
                        f'{2 * STOP_HZ:g}')
    sections = butter(2, PASS_HZ, fs=rate, output='sos')
    return Series({**{name: sosfiltfilt(sections, series[name])
                      for name in ('command', 'opening')}, 'raw': series['opening']},
                  series.sample_time, series.start, series.source)


def _liveliest(series: Series, size: int) -> Series:
    """Cut out the `size` samples over which the command varies most."""
    u = series['command'] - series['command'].mean()
    sums = np.cumsum(np.pad(np.column_stack([u, u**2]), ((1, 0), (0, 0))), axis=0)
    first, second = ((sums[size:] - sums[:-size]) / size).T
    begin = int(np.argmax(second - first**2))
    return series.part(begin, begin + size)


def _free_run(weights: Weights, regressors: FloatArray) -> FloatArray:
    """Run the difference equation on its own past, from the past in the first row."""
    b, a = np.array(weights.v), np.array([1.0, *(-n for n in weights.n)])
    state = lfiltic(b, a, y=regressors[0, 2:], x=regressors[0, 1:2])
    with np.errstate(over='ignore', invalid='ignore'):      # weights may be unstable
        run, _ = lfilter(b, a, regressors[:, 0], zi=state)
    return np.asarray(run, dtype=float)


def _parameters_or_reason(reading: Reading, weights: Weights, T: float,
                          k_1: float) -> LoopParameters | str:
    try:
        return reading(weights, T, k_1)
    except DataError as error:
        return str(error)
