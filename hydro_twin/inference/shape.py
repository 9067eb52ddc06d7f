"""What an effect does at its port, beside what the recording shows there without any law.

A component-plus-residual plot [Larsen and McCleary 1972]: what the model leaves is added to what
the effect does, and a free curve over a signal at the port, carried to the output by the linear
laws, is fitted to the sum. Where the law is right, the free curve runs along it.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import signal
from scipy.linalg import block_diag

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Course, Placed
from hydro_twin.fitting.autoregression import autoregression, filtered, whiten
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import fitted_residuals
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import BLOCK
from hydro_twin.inference.effect_signals import effect_signals, EffectSignals
from hydro_twin.inference.starts import with_other
from hydro_twin.inference.structure import hats, times, to_output
from hydro_twin.predictors.scores import rms
from hydro_twin.result import FreeCurve, OverTime, Profile, Shape

KNOTS = 8               # evenly spaced, and as many again at quantiles
CLOSEST = 0.02          # of two knots, as a share of the reach
JUMP = 0.01             # the same, where a force jumps
DOTS = 1500             # of a law
TRIALS = 25             # values at which the error of linear dynamics is shown
WIDEST = 1.0            # standard error of a knot worth showing, over the reach of the law
NOTHING = 1e-300        # length of a column of zeros, so that it can be divided by


def component_plus_residual(fit: Fit, placed: Placed, seen: Sequence[EffectSignals], name: str
                            ) -> list[FreeCurve]:
    """Fit a free curve of what is added at a port over a signal; two for a law with memory.

    Least squares on the residual plus the contribution of the effect, whitened by an
    autoregressive model of the former. All else in the model is held, except the initial state of
    each part, which the first samples hardly determine. Standard errors are clustered by blocks,
    so that they hold for a structured residual, each block predicted by the others, since a knot
    may be visited in a few blocks only [Bell and McCaffrey 2002, the jackknife].

    Returns:
        One curve, or one for a rising and one for a falling signal. The standard error of a knot
        that no sample is near is infinite.
    """
    carry, start_up = to_output(fit.candidate), fit.candidate.start_up
    b = carry.b[:, fit.candidate.plant.ports.index(placed.port)]
    a = np.concatenate([[1.0], carry.a])
    filter_ = autoregression(fit.by_part)
    reach = np.concatenate([p.signals[name] for p in seen])
    knots = _knots(reach, placed.effect.implicit)

    def whitened(columns: FloatArray) -> FloatArray:
        return filtered(filter_, columns)[start_up:]

    columns, target, starts = [], [], []
    for p in seen:
        shape = hats(p.signals[name], knots)
        if placed.branches:
            rises = _rises(p.signals[name])[:, None]
            shape = np.hstack([shape * rises, shape * ~rises])
        columns.append(whitened(signal.lfilter(b, a, shape, axis=0)))
        target.append(whitened(p.left + signal.lfilter(b, a, p.added)))
        starts.append(whitened(fit.candidate.system.free_response(len(p.left))))
    t = np.concatenate(target)
    X = np.hstack([np.concatenate(columns), block_diag(*starts)])
    X, size, covariance, found = _least_squares(X, t)
    residual, pulls = t - X @ found, []
    for begin in range(0, len(t), BLOCK):
        block = X[begin:begin + BLOCK]
        others = np.eye(len(block)) - block @ covariance @ block.T
        pulls.append(block.T @ np.linalg.pinv(others, rcond=1e-6, hermitian=True)
                     @ residual[begin:begin + BLOCK])
    spread = covariance @ (np.transpose(pulls) @ np.array(pulls)) @ covariance
    count = columns[0].shape[1]
    curve, error = (found / size)[:count], _errors(spread, size)[:count]
    if not placed.branches:
        return [FreeCurve('free curve', knots, curve, error)]
    half = len(knots)
    return [FreeCurve('free curve, rising', knots, curve[:half], error[:half]),
            FreeCurve('free curve, falling', knots, curve[half:], error[half:])]


def _least_squares(X: FloatArray, target: FloatArray
                   ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit a target (N,) by columns (N, d) that may depend on one another.

    Returns:
        The columns scaled to unit length, their lengths, the inverse of their products, and the
        weights of the scaled ones.
    """
    size = np.maximum(np.linalg.norm(X, axis=0), NOTHING)
    scaled = X / size
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True)
    return scaled, size, covariance, covariance @ (scaled.T @ target)


def _errors(covariance: FloatArray, size: FloatArray) -> FloatArray:
    """Return standard errors from the covariance of scaled weights; inf for a column of zeros."""
    errors: FloatArray = np.where(
        size > NOTHING, np.sqrt(np.diag(covariance)) / size, np.inf)
    return errors


def _rises(values: FloatArray) -> np.ndarray:
    """Whether a signal rises, or rose when it last moved, (N,)."""
    moves = np.diff(values, prepend=values[0])
    last = np.maximum.accumulate(np.where(moves != 0.0, np.arange(len(values)), 0))
    rising: np.ndarray = moves[last] > 0.0
    return rising


def _knots(reach: FloatArray, jumps: bool = False) -> FloatArray:
    """Place knots evenly over what a signal reaches, and more where it often is.

    Where what is added may jump as the signal changes sign, three stand close about zero.
    """
    low, high = np.quantile(reach, [0.002, 0.998])
    size = high - low
    kept = JUMP * size * np.array([-1.0, 0.0, 1.0]) if jumps and low < 0.0 < high else np.zeros(0)
    for knot in (*np.linspace(low, high, KNOTS),
                 *np.quantile(reach, np.linspace(0.05, 0.95, KNOTS))):
        if np.all(np.abs(knot - kept) > CLOSEST * size):
            kept = np.append(kept, knot)
    return np.sort(kept)


def dominant_signal(seen: Sequence[EffectSignals]) -> str:
    """Name the signal that what the effect adds depends on most plainly."""
    added = np.concatenate([p.added for p in seen])
    unexplained = {}
    for name in seen[0].signals:
        values = np.concatenate([p.signals[name] for p in seen])
        columns = hats(values, _knots(values))
        weights = np.linalg.lstsq(columns, added, rcond=None)[0]
        unexplained[name] = rms(added - columns @ weights)
    return min(unexplained, key=lambda name: unexplained[name])


def shape_of(fit: Fit, placed: Placed, parts: Sequence[Part]) -> Shape | Profile | OverTime:
    """Show an effect at its port; of linear dynamics, which have no curve there, a profile.

    Args:
        fit: the model with the effect.
        placed: the effect, one of the model's.
        parts: what was fitted.
    """
    if placed.effect.linear:
        return _profile(fit, placed, parts)
    if placed.effect.course is not None:
        return _over_time(fit, placed, placed.effect.course, parts)
    seen = [effect_signals(fit.candidate, placed, part) for part in parts]
    over = dominant_signal(seen)
    start_up = fit.candidate.start_up
    x = np.concatenate([p.signals[over][start_up:] for p in seen])
    added = np.concatenate([p.added[start_up:] for p in seen])
    every = -(-len(x) // DOTS)
    widest = WIDEST * max(float(np.ptp(added)), abs(float(added.max())))
    curves = []
    for curve in component_plus_residual(fit, placed, seen, over):
        known = curve.std_error < widest
        curves.append(FreeCurve(curve.label, curve.knots[known], curve.added[known],
                                curve.std_error[known]))
    return Shape(over, len(seen[0].signals), x[::every], added[::every], tuple(curves))


def _over_time(fit: Fit, placed: Placed, course: Course, parts: Sequence[Part]) -> OverTime:
    """Show the value of a parameter over time, by its law and by itself in spells of time.

    The latter by least squares on what the model leaves, whitened, with all other unknowns free.
    """
    fit, begin, end = fit.main, placed.named['begin'], placed.named['end']
    last = fit.candidate.values[placed.port.name]

    def value(time: FloatArray) -> FloatArray:
        return last * course.factor(placed.values, begin + time)

    time = times(fit, parts) + 1e-9 * min(part.start for part in parts) - begin
    knots = np.linspace(time.min(), time.max(), KNOTS)
    own = [u.owner == '' and u.name == placed.port.name for u in fit.unknowns]
    index = str(fit.candidate.effects.index(placed))
    others = [not mine and u.owner != index for mine, u in zip(own, fit.unknowns, strict=True)]
    columns = np.hstack([fit.jacobian[:, own] * hats(time, knots), fit.jacobian[:, others]])
    filter_, cuts = autoregression(fit.by_part), np.cumsum(fit.lengths)[:-1]
    X = np.column_stack([whiten(np.split(column, cuts), filter_) for column in columns.T])
    target = whiten(fit.by_part, filter_)
    X, size, covariance, found = _least_squares(X, target)
    error = rms(target - X @ found) * _errors(covariance, size)[:KNOTS]
    found = (found / size)[:KNOTS]
    known = np.isfinite(error)          # not in a pause between recordings
    at_knots, line = value(knots), np.linspace(0.0, end - begin, DOTS)
    return OverTime(line, value(line), FreeCurve('by itself', knots[known], (
        at_knots * (1.0 + found))[known], (at_knots * error)[known]))


def _profile(fit: Fit, placed: Placed, parts: Sequence[Part]) -> Profile:
    """Run with other values of the first parameter, up to twice the fitted one.

    From none, if it is a time; from half, if it is a frequency, of which none passes nothing.
    """
    index = fit.candidate.effects.index(placed)
    least = 0.0 if placed.effect.parameters[0].unit == 's' else 0.5
    values = placed.values[0] * np.linspace(least, 2.0, TRIALS)
    errors = []
    for value in values:
        moved = with_other(fit.candidate, index, replace(
            placed, values=(float(value), *placed.values[1:])))
        errors.append(rms(np.concatenate(fitted_residuals(moved, parts))))
    return Profile(values, np.array(errors), fit.error)
