"""Takes the jitter out of receive times: those of a steady rate lie on a line over the counts."""
from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hydro_twin.recording.cdr import IntArray
from hydro_twin.recording.series import FloatArray

WINDOW = 100   # messages over which the earliest arrival shows the delay that all have in common
SHORTEST = 20   # fewer messages do not make a line
MAX_LOST = 5   # after more the sender may have started anew
DOUBT = 0.25   # of a period: from 0.75 on a common delay is a loss
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

    Its slope is the median of the slopes between the halves of the record, its height the median
    of what is left.
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


def count_messages(time: FloatArray) -> FloatArray:
    """Count the messages, those that were lost too.

    A stall also makes a long pause, but what was held up then arrives in a burst, so that soon
    some message is in time again; after a loss none is.
    """
    counts = np.arange(len(time), dtype=np.float64)
    span = min(WINDOW, len(time) - 1)
    period = np.median(time[span:] - time[:-span]) / span
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
