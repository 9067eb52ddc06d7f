"""Takes the jitter out of receive times: those of a steady rate lie on a line over the counts."""
from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hydro_twin.arrays import FloatArray, IntArray

WINDOW = 100   # messages over which the earliest arrival shows the delay that all have in common
SHORTEST = 20   # fewer messages do not make a line
MAX_LOST = 5   # after more the sender may have restarted
DOUBT = 0.25   # of a period: from 0.75 on a common delay is a loss
MOST_LOST = 0.35   # share of messages that may be lost, and their rate still be found
SAMPLED = 10   # windows in which the rate is looked for, spread over the record
AGREE = 0.5   # agreement in phase from which there is a rate: jitter of under a fifth of a period
STEADY = 1.0   # typical distance from the line, in periods, up to which the rate counts as steady


def remove_jitter(received: IntArray) -> IntArray:
    """Put receive times on lines through the counts of the messages.

    Lost messages are counted; where many are missing, a new line begins.

    Args:
        received: receive times, increasing [ns].

    Returns:
        Strictly increasing times [ns], those received where there is no steady rate.
    """
    if len(received) < SHORTEST:
        return received
    counts = count_messages((received - received[0]).astype(np.float64))
    breaks = np.flatnonzero(np.diff(counts) > MAX_LOST + 1) + 1
    lined = np.concatenate([_line(times, numbers) for times, numbers in zip(
        np.split(received, breaks), np.split(counts, breaks), strict=True)])
    return lined if (np.diff(lined) > 0).all() else received


def _line(received: IntArray, counts: FloatArray) -> IntArray:
    """Fit a line that late arrivals do not move.

    The slope is the median of the slopes between the halves of the record; the intercept is the
    median of the residuals.
    """
    if len(received) < SHORTEST:
        return received
    time = (received - received[0]).astype(np.float64)
    half = len(time) // 2
    period = np.median((time[half:] - time[:-half]) / (counts[half:] - counts[:-half]))
    late = time - period * counts
    height = np.median(late)
    if period < 1.0 or np.median(np.abs(late - height)) > STEADY * period:
        return received
    line: IntArray = received[0] + np.rint(height + period * counts).astype(np.int64)
    return line


def sending_period(time: FloatArray) -> float:
    """Estimate the period at which messages were sent, lost ones or not.

    The mean distance of the messages is too long by the share that was lost. At the true period
    the arrivals of a window agree in phase [Rayleigh's test for directions], lost or not; of the
    periods up to the mean distance the one with the best agreement is taken; where none agrees,
    as under jitter of a period, the mean distance.

    Args:
        time: receive times, (N,), N above 1.

    Returns:
        The period in the unit of the times; 0 where most messages came at once.
    """
    span = min(WINDOW, len(time) - 1)
    distances = time[span:] - time[:-span]
    longest = float(np.median(distances)) / span
    if not longest > 0.0:
        return 0.0
    begins = np.unique(np.linspace(0, len(time) - 1 - span, SAMPLED).astype(int))
    windows = sliding_window_view(time, span + 1)[begins]
    windows = windows - windows[:, :1]
    # A quarter of a turn over a window from one period to the next, so that no peak is missed.
    steps = np.arange(-4.0, 4.0 * span * MOST_LOST / (1.0 - MOST_LOST))
    periods = longest / (1.0 + steps / (4.0 * span))
    agreement = np.array([np.mean(np.abs(np.mean(np.exp(2j * np.pi / period * windows), axis=1)))
                          for period in periods])
    best = int(np.argmax(agreement))
    if agreement[best] <= AGREE:
        return longest
    return float(np.median(distances / np.maximum(np.rint(distances / periods[best]), 1.0)))


def count_messages(time: FloatArray) -> FloatArray:
    """Count the messages, those that were lost too.

    A stall also makes a long pause, but what was held up then arrives in a burst, so that soon
    some message is in time again; after a loss none is.
    """
    counts = np.arange(len(time), dtype=np.float64)
    span = min(WINDOW, len(time) - 1)
    period = sending_period(time)
    if not period > 0.0:
        return counts
    delay = time - period * counts
    edge = np.full(span, np.inf)
    earliest = sliding_window_view(np.concatenate([edge, delay, edge]), span).min(axis=1)
    rise = earliest[span:-1] - earliest[:-span - 1]   # of the earliest after k over that before
    for k in np.flatnonzero(rise[1:] > (1.0 - DOUBT) * period) + 1:
        before = delay[max(0, k - span):k].min()
        lost = math.floor((delay[k:k + span].min() - before) / period + DOUBT)
        if lost > 0:
            counts[k:] += lost
            delay[k:] -= lost * period
    return counts
