"""The compiled step of the observer: a Kalman filter in square-root form.

The filter estimates the states of the plant, the memory of the effects and the followed parameters
together. The prediction propagates the estimate by the compiled step, and the square root S of its
covariance, P = S S', by the derivatives of that step, with each law linearised statistically over
the uncertainty of its input. Process noise is then added, and reflections make S triangular again
[Kaminski et al. 1971]. A measurement updates both by Potter's formula [Bierman 1977, II.3]. So P
stays symmetric and positive semidefinite despite rounding, and definite in the states where there
is process noise.

Output and sensors have independent noise, so they are taken in one after another, each as a single
measurement, and one that is missing is passed over. All are made linear where the output is.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from hydro_twin.arrays import FloatArray
from hydro_twin.compiled import compiled
from hydro_twin.predictors.follow import follow_by
from hydro_twin.predictors.kernel import LIMIT
from hydro_twin.predictors.step_derivatives import advance, divided, output, read_sensor
from hydro_twin.predictors.tangents import split_rows

# The gate of a sensor: its squared innovation over the variance that the filter expects, sample by
# sample [Bar-Shalom, Li and Kirubarajan 2001, 5.4]. Chance exceeds five standard deviations once
# in two million samples. A stuck or biased sensor may pass the gate for a while. So the mean of
# this ratio, the normalised innovation squared (NIS), over about `NIS_SAMPLES` samples, each
# clipped at the gate, must also stay below `NIS_SHARE` times the gate: an RMS of twice the
# expected deviation. Neither chance alone (some twenty standard deviations of that exponential
# mean) nor a single outlier reaches it.
GATE, NIS_SAMPLES, NIS_SHARE = 5.0 ** 2, 50.0, 0.16


class Filter(NamedTuple):
    """What the observer needs beside the step, for n states, N with memory and parameters.

    Attributes:
        start: root of the covariance at the start, (N, C) with room for `used` columns.
        process: root of the covariance that a sample adds to the states, (n, n).
        walks: standard deviation by which a sample moves each parameter that is followed, (Q,).
        used: columns at work: N, those of the process noise, and one for each law.
        variances: of the noise of the output and of each sensor of the plant, (1 + R,); nan of a
            sensor whose noise is not known, which is not used.
        gate: squared innovation of a sensor over its variance beyond which it is not believed.
        reset_deviation: of the predicted output: a standard deviation beyond which the covariance
            begins anew.
        shown: what is estimated beside the prediction, as sums of states, memory and parameters,
            then inputs and what effects add to the ports, (R, N + m + P).
    """

    start: FloatArray
    process: FloatArray
    walks: FloatArray
    used: int
    variances: FloatArray
    gate: float
    reset_deviation: float
    shown: FloatArray


class Scratch(NamedTuple):
    """What `run` works in.

    Attributes:
        S: root of the covariance of states, memory and parameters, (N, C).
        blocks: the same as rows of derivatives.
        room: for the other rows of a step.
        work: of the kernel.
        g: partial derivatives of a law.
        v: rows like those of S, one to work in, then one for each of output and sensors,
            (2 + R, C).
        nis: of output and sensors, the mean normalised innovation squared over about the last
            `NIS_SAMPLES` samples, (1 + R,); kept for the sensors.
    """

    S: FloatArray
    blocks: FloatArray
    room: FloatArray
    work: FloatArray
    g: FloatArray
    v: FloatArray
    nis: FloatArray


@compiled
def triangularise(S, columns, v):  # type: ignore[no-untyped-def]
    """Make S lower triangular by reflections of its columns, which leave S S' as it is."""
    N = len(S)
    for i in range(N):
        square = 0.0
        for c in range(i, columns):
            v[c] = S[i, c]
            square += v[c] * v[c]
        if square == 0.0:
            continue
        norm = -math.copysign(math.sqrt(square), v[i])
        v[i] -= norm
        scale = 1.0 / (square - norm * S[i, i])
        S[i, i] = norm
        for c in range(i + 1, columns):
            S[i, c] = 0.0
        for j in range(i + 1, N):
            along = 0.0
            for c in range(i, columns):
                along += S[j, c] * v[c]
            along *= scale
            for c in range(i, columns):
                S[j, c] -= along * v[c]


@compiled
def show(shown, S, x, z, q, u, d, v, estimate):  # type: ignore[no-untyped-def]
    """Write sums of what is known, and their standard deviations, into estimate (2, R)."""
    n, w, N, m = len(x), len(z), len(S), len(u)
    for r in range(len(shown)):
        value = square = 0.0
        for c in range(N):
            v[c] = 0.0
        for i in range(N):
            weight = shown[r, i]
            if weight != 0.0:
                value += weight * (x[i] if i < n else z[i - n] if i < n + w else q[i - n - w])
                for c in range(N):
                    v[c] += weight * S[i, c]
        for i in range(m):
            value += shown[r, N + i] * u[i]
        for i in range(len(d)):
            value += shown[r, N + m + i] * d[i]
        for c in range(N):
            square += v[c] * v[c]
        estimate[0, r], estimate[1, r] = value, math.sqrt(square)


@compiled
def innovation_variance(noise, slope, N):  # type: ignore[no-untyped-def]
    """Return the noise of a measurement, and the variance of its innovation.

    The noise includes the residual variance of the linearised laws, in the columns after the
    first N.
    """
    for j in range(N, len(slope)):
        noise += slope[j] * slope[j]
    variance = noise
    for j in range(N):
        variance += slope[j] * slope[j]
    return noise, variance


@compiled
def update(  # type: ignore[no-untyped-def]
        S, slope, noise, variance, innovation, x, z, slow):
    """Update the estimate, and the square root of its covariance, with one scalar measurement.

    slope (N or more,) holds the derivatives of the measured quantity along the columns of S.
    """
    n, w, N = len(x), len(z), len(S)
    shrink = 1.0 / (variance + math.sqrt(noise * variance))
    for i in range(N):
        covariance = 0.0
        for j in range(N):
            covariance += S[i, j] * slope[j]
        share = covariance / variance
        if i < n:
            x[i] += share * innovation
        elif i < n + w:
            z[i - n] += share * innovation
        elif slow is not None:
            c = i - n - w
            slow.now[c] = min(max(slow.now[c] + share * innovation, slow.low[c]), slow.high[c])
        for j in range(N):
            S[i, j] -= shrink * covariance * slope[j]


@compiled
def move_sensors(  # type: ignore[no-untyped-def]
        N, slopes, o, noise, variance, innovation, result):
    """Move what the sensors after output o will read, and its derivatives, like a row of S."""
    shrink = 1.0 / (variance + math.sqrt(noise * variance))
    for p in range(o + 1, len(slopes)):
        if result[2 * p] == result[2 * p]:
            covariance = 0.0
            for j in range(N):
                covariance += slopes[p, j] * slopes[o, j]
            result[2 * p] += covariance / variance * innovation
            for j in range(N):
                slopes[p, j] -= shrink * covariance * slopes[o, j]


@compiled
def read_sensors(  # type: ignore[no-untyped-def]
        step, tangent, variances, x, z, work, rows, measured, slopes, result):
    """Predict what is measured of the sensors at a sample, after `output`; nan of the others."""
    for o in range(1, len(measured)):
        result[2 * o] = result[2 * o + 1] = float('nan')
        if measured[o] == measured[o] and variances[o] > 0.0:
            result[2 * o] = read_sensor(step, tangent, step.sensors + o - 1, x, z, work, rows,
                                        slopes[o])


@compiled
def update_by_sensors(  # type: ignore[no-untyped-def]
        S, slopes, variances, gate, nis, x, z, slow, measured, result):
    """Take in what the sensors read at a sample, one after another, as far as it is believed."""
    for o in range(1, len(measured)):
        innovation = measured[o] - result[2 * o]
        if innovation == innovation:
            noise, variance = innovation_variance(variances[o], slopes[o], len(S))
            result[2 * o + 1] = variance
            ratio = innovation * innovation / variance
            nis[o] += (min(ratio, gate) - nis[o]) / NIS_SAMPLES
            if ratio <= gate and nis[o] <= NIS_SHARE * gate:
                update(S, slopes[o], noise, variance, innovation, x, z, slow)
                move_sensors(len(S), slopes, o, noise, variance, innovation, result)


@compiled
def run(  # type: ignore[no-untyped-def]
        step, tangent, filter_, scratch, slow, x, z, inputs, measured, begin, end, results,
        estimates, gains):
    """Predict each sample from begin to end, and update with what is measured there, if anything.

    x, z, the followed parameters and the square root of their covariance are updated in place.
    measured (M, 1 or 1 + R) holds the output and the sensors of the plant, nan where there is
    none. results (M, 2 or 2 + 2R) receives, for each of them, its prediction from all measurements
    processed before it, and the variance of the innovation; nan for a sensor that is not there.
    estimates (M, 2, R), if not empty, receives the estimates after each sample and their standard
    deviations; gains (M, n + memory), if not empty, the gains of state and memory for the output.
    After a divergence, results and estimates are nan. slow is None where no parameter is followed:
    this case is compiled separately, since passing unused arrays would take as long as the rest.
    Returns the sample after the last one done. The run ends early where a parameter has moved so
    far that the matrices must be recomputed.
    """
    S, blocks, room, work, g, v, nis = scratch
    tangent = split_rows(step, tangent)
    n, N, w, used, variances = len(x), len(S), len(z), filter_.used, filter_.variances
    m = len(step.shift)
    q = x[:0] if slow is None else slow.now
    P = step.H.shape[1] - n - m
    rows, walking = divided(blocks[:n], blocks[n:n + w], room, m, P), blocks[n + w:]
    free, slopes = v[0], v[1:, :used]
    everywhere = measured.shape[1] > 1 or len(estimates) > 0
    slope = slopes[0]
    for k in range(begin, end):
        if k > 0:
            if slow is not None:
                follow_by(step, tangent, slow, walking)
            advance(step, tangent, x, z, work, rows, g, inputs, k)
            for i in range(n):
                for j in range(n):
                    S[i, N + j] = filter_.process[i, j]
            for i in range(len(q)):
                S[n + w + i, N + n + i] = filter_.walks[i]
            triangularise(S, used, free)
        if slow is not None:
            follow_by(step, tangent, slow, walking)
        y = output(step, tangent, x, z, work, rows, g, inputs, k, everywhere, slope)
        if not abs(y) < LIMIT:
            results[k:end] = float('nan')
            estimates[k:end] = float('nan')
            return end
        noise, variance = innovation_variance(variances[0], slope, N)
        known = variance <= filter_.reset_deviation * filter_.reset_deviation
        if measured.shape[1] > 1:
            read_sensors(step, tangent, variances, x, z, work, rows, measured[k], slopes,
                         results[k])
        if not known:
            variance = filter_.reset_deviation * filter_.reset_deviation
            for i in range(N):
                for j in range(S.shape[1]):
                    S[i, j] = filter_.start[i, j]
        results[k, 0], results[k, 1] = y, variance
        innovation = measured[k, 0] - y
        if known and innovation == innovation:
            if len(gains) > 0:
                for i in range(n + w):
                    covariance = 0.0
                    for j in range(N):
                        covariance += S[i, j] * slope[j]
                    gains[k, i] = covariance / variance
            update(S, slope, noise, variance, innovation, x, z, slow)
            if measured.shape[1] > 1:
                move_sensors(N, slopes, 0, noise, variance, innovation, results[k])
        if known and measured.shape[1] > 1:
            update_by_sensors(S, slopes, variances, filter_.gate, nis, x, z, slow, measured[k],
                              results[k])
        if len(estimates) > 0:
            show(filter_.shown, S, x, z, q, work[1, :m], work[5, :P], free, estimates[k])
        if slow is not None:
            for i in range(len(q)):
                if abs(q[i] - slow.at[i]) > slow.far[i]:
                    return k + 1
    return end
