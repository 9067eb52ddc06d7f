"""The one-step error of a difference equation, shrunk once to a triangular factor."""
from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.recording.series import Series

BLOCK = 4096        # rows factored at once: they stay in the processor's cache


def triangle(blocks: Iterable[FloatArray]) -> FloatArray:
    """Factor the rows of all blocks, stacked, into one triangle R with R'R = A'A.

    Only one block is held at a time.

    Args:
        blocks: arrays of m columns each; at least one.

    Returns:
        Shape (m, m), upper triangular; rows of zeros where there are fewer than m rows in all.
    """
    R: FloatArray | None = None
    for block in blocks:
        R = np.linalg.qr(block if R is None else np.vstack((R, block)), mode='r')
    if R is None:
        raise ValueError('no rows to factor')
    return np.vstack((R, np.zeros((R.shape[1] - len(R), R.shape[1]))))


@dataclass(frozen=True)
class Regression:
    """All that a fit of y(k) = x(k) c needs to know of the samples, whatever their number.

    Factors of several recordings combine by `+`.

    Attributes:
        R: triangular factor of [x | y], shape (m + 1, m + 1).
        patterns: number of rows (k) that it holds.
    """

    R: FloatArray
    patterns: int

    def __add__(self, other: Regression) -> Regression:
        """Combine with the patterns of another recording."""
        return Regression(triangle((self.R, other.R)), self.patterns + other.patterns)

    def rms(self, coefficients: FloatArray) -> FloatArray:
        """Compute the root mean square of y - x c, [B19] eq. 5, without the samples.

        Args:
            coefficients: shape (..., m), one candidate or a population.

        Returns:
            Shape (...), in the unit of y.
        """
        e = coefficients @ self.R[:, :-1].T - self.R[:, -1]
        rms: FloatArray = np.sqrt(np.einsum('...i,...i', e, e) / self.patterns)
        return rms

    def best(self) -> FloatArray:
        """Solve for the m coefficients without constraint; no physical model has a lower rms."""
        X, y = self.R[:, :-1], self.R[:, -1]
        scale = np.linalg.norm(X, axis=0)
        scale[scale == 0.0] = 1.0
        return np.linalg.lstsq(X / scale, y, rcond=None)[0] / scale

    def persistence(self) -> float:
        """Root mean square of y(k) - y(k-1): the error of repeating the last sample."""
        repeat = np.zeros(len(self.R) - 1)
        repeat[0] = 1.0
        return float(self.rms(repeat))


def regressors(
    series: Series, output: str, inputs: Sequence[str], order: int, block: int = BLOCK,
) -> Iterator[FloatArray]:
    """Yield the rows [y(k-1..k-n), u(k..k-n) of every input | y(k)], in blocks.

    As in [B19], the first order + 1 samples only feed the regressors: 1000 samples give 995
    patterns for order 4.

    Args:
        series: the samples.
        output: name of y.
        inputs: names of the u, in the order in which their columns come.
        order: n, the number of past samples.
        block: rows in one block.

    Yields:
        Shape (up to block, order + (order + 1) * inputs + 1).
    """
    for begin in range(order + 1, len(series), block):
        end = min(begin + block, len(series))
        y, *u = (sliding_window_view(series[name][begin - order:end], order + 1)[:, ::-1]
                 for name in (output, *inputs))
        yield np.concatenate((y[:, 1:], *u, y[:, :1]), axis=1)


def regression(
    stretches: Iterable[Series], output: str, inputs: Sequence[str], order: int,
) -> Regression:
    """Factor the one-step problem of all stretches, in memory that does not grow with them.

    A long stretch may be given in pieces that overlap by order + 1 samples: the result is the
    same.

    Args:
        stretches: the samples; each stretch has a start of its own.
        output: name of y.
        inputs: names of the inputs.
        order: order of the difference equation.

    Raises:
        DataError: a sample is not finite, there are fewer patterns than coefficients, or the
            output or every input never changes.
    """
    total, low, high = factored(stretches, output, inputs, order)
    wanted = order + (order + 1) * len(inputs)
    if total is None or total.patterns <= wanted:
        raise DataError(f'too short: {total.patterns if total else 0} patterns for {wanted} '
                        f'coefficients; each stretch loses its first {order + 1} samples')
    if low[0] == high[0]:
        raise DataError(f'{output} is constant at {low[0]:g}: there is no response to fit')
    if (low[1:] == high[1:]).all():
        raise DataError(f'{", ".join(inputs)} never change: nothing excites the plant')
    return total


def factored(
    stretches: Iterable[Series], output: str, inputs: Sequence[str], order: int,
) -> tuple[Regression | None, FloatArray, FloatArray]:
    """Factor stretches as `regression` does, whether they can be fitted or not.

    Returns:
        The factor, None without a pattern; the least and the greatest sample of the output and of
        each input, shape (1 + inputs,).

    Raises:
        DataError: a sample is not finite.
    """
    columns = (output, *inputs)
    total: Regression | None = None
    low, high = np.full(len(columns), np.inf), np.full(len(columns), -np.inf)
    for series in stretches:
        for i, name in enumerate(columns):
            low[i] = np.minimum(low[i], series[name].min(initial=np.inf))   # keeps a NaN
            high[i] = np.maximum(high[i], series[name].max(initial=-np.inf))
            if len(series) and not np.isfinite((low[i], high[i])).all():
                raise DataError(f'{series.source or "recording"}: {name} has samples that are '
                                'not finite; remove or fill them first')
        if (patterns := len(series) - order - 1) > 0:
            R = triangle(regressors(series, output, inputs, order))
            part = Regression(R, patterns)
            total = part if total is None else total + part
    return total, low, high
