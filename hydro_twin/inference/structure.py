"""Whether a residual has structure: depends on what passes at the ports, or on time.

At each port, for each signal there, a free curve (hat functions over what the signal reaches) is
added to the port's value and carried to the output by the linear laws. What such a curve explains
of the residual, beyond what re-estimated parameters do, is a dependence that the model lacks,
whatever its law.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import signal

from hydro_twin.arrays import FloatArray
from hydro_twin.effects.curve import KNOTS
from hydro_twin.fitting.fit import Fit, project_out
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import explained, simulate_port_signals
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic
from hydro_twin.inference.noise import cannot_be_noise
from hydro_twin.model import Model
from hydro_twin.plants.difference_equation import DifferenceEquation, from_state_space
from hydro_twin.predictors.system import discretise
from hydro_twin.result import Dependence, TIME

LEVEL = 0.01            # of the test, for all dependences together
WORTH = 0.01            # least share that is reported
DRIFTS = 0.05           # least share of a drift that is reported
SPELLS = 25             # knots over time: an offset that jumps is met to a few per cent
JUMPS = 7               # times at which a parameter may jump, to start a search at


def to_output(candidate: Model) -> DifferenceEquation:
    """Difference equation from what is added at each port to the output, linear laws only."""
    laws = candidate.system.laws
    n, m = laws.B.shape
    P = len(candidate.plant.ports)
    M = discretise(laws, candidate.sample_time)
    Phi, begin, end = M[:, :n], M[:, n + 2 * m:n + 2 * m + P], M[:, n + 2 * m + P:]
    direct = laws.port_d[-1:].copy()
    direct[0, -1] += 1.0
    return from_state_space(Phi, begin + Phi @ end, laws.C, laws.C @ end + direct)


def hats(values: FloatArray, knots: FloatArray) -> FloatArray:
    """Evaluate the hat functions over the knots, (N, len(knots))."""
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))], axis=1)


def dependences(fit: Fit, parts: Sequence[Part]) -> list[Dependence]:
    """Find what the residual of a fit depends on, the strongest first.

    Only dependences are returned that predict blocks of the residual that they were not fitted
    to, better than noise would.
    """
    found = free_curves(fit, parts)
    if is_moving_offset(fit, fit, parts):
        found.append(over_time(fit, parts))
    return sorted(filter(is_significant_dependence, found), key=lambda d: -d.share)


def is_significant_dependence(curve: Dependence) -> bool:
    """Whether noise would hardly explain as much."""
    return curve.p_value <= LEVEL and curve.share >= WORTH


def free_curves(fit: Fit, parts: Sequence[Part]) -> list[Dependence]:
    """List what a free curve explains at every port over every signal there, the most first."""
    fit, candidate = fit.main, fit.candidate
    carry = to_output(candidate)
    observed = simulate_port_signals(candidate, parts)
    basis = fit.tangent_basis
    groups = _groups(candidate)
    found = []
    for port, name, row in groups:
        reach = np.concatenate([seen[:, row] for seen in observed])
        low, high = np.quantile(reach, [0.001, 0.999])
        if not high - low > 1e-12 * max(abs(low), abs(high), 1e-300):
            continue
        knots = np.linspace(low, high, KNOTS)
        filter_ = carry.b[:, port]
        columns = np.concatenate([
            part.whitened(_carried(hats(seen[:, row], knots), filter_, carry.a))[
                candidate.start_up:] for part, seen in zip(parts, observed, strict=True)])
        weights, share, p_value = explained(columns, fit.residual, basis)
        found.append(Dependence(candidate.plant.ports[port], name, share,
                                min(1.0, p_value * len(groups)), knots, weights))
    return sorted(found, key=lambda d: -d.share)


def over_time(fit: Fit, parts: Sequence[Part]) -> Dependence:
    """Say what an offset of the output that changes with time explains.

    As where the zero of a sensor or a constant load moves. A slow residual also follows slow
    signals, by chance, but no better than time.
    """
    fit = fit.main
    knots, columns = _offsets(fit, parts)
    weights, share, p_value = explained(columns, fit.residual, fit.tangent_basis)
    return Dependence(fit.candidate.plant.ports[-1], TIME, share, p_value, knots, weights)


def is_moving_offset(base: Fit, named: Fit, parts: Sequence[Part]) -> bool:
    """Whether an offset that moves with time explains all there is, and clearly more than effects.

    By the BIC, all parameters being free to change with it by a little. A slow residual is
    imitated by many a law, as by a ripple of few periods. Never where the plant integrates: there
    the initial states of the windows take an offset up.

    Args:
        base: a fit without the effects.
        named: the same with them, or the base where there are none.
        parts: what both were fitted to.
    """
    if base.candidate.plant.integrates:
        return False
    fit, (_, columns) = base.main, _offsets(base.main, parts)
    basis = np.linalg.qr(np.column_stack([fit.tangent_basis, columns]))[0]
    moving = replace(fit, residual=project_out(fit.residual, basis))
    apart, then = delta_bic([named.main, moving], [named.main.free, fit.free + columns.shape[1]])
    return then + CLEAR_DELTA_BIC < apart and not cannot_be_noise(moving.by_part)


def _offsets(fit: Fit, parts: Sequence[Part]) -> tuple[FloatArray, FloatArray]:
    """Return knots over time, (K,), and hat functions over them, whitened, at scored samples.

    These are (N, K), for K up to `SPELLS`.
    """
    time = _times(parts, fit.candidate.sample_time)
    knots = np.linspace(min(map(np.min, time)), max(map(np.max, time)), SPELLS)
    columns = np.concatenate([part.whitened(hats(t, knots))[fit.candidate.start_up:]
                              for part, t in zip(parts, time, strict=True)])
    met = columns.any(axis=0)       # not where all is held out
    return knots[met], columns[:, met]


def drift_test(fit: Fit, parts: Sequence[Part]) -> tuple[float, float]:
    """Share and p-value of a change of the parameters with time: tangents times courses.

    In a straight line, or at once at the best of some times, whichever explains more.
    """
    fit = fit.main
    basis, time = fit.tangent_basis, times(fit, parts)
    residual = project_out(fit.residual, basis)

    def columns(course: FloatArray) -> FloatArray:
        return fit.jacobian * (course - course.mean())[:, None]

    def explains(course: FloatArray) -> float:
        found = np.linalg.qr(project_out(columns(course), basis))[0].T @ residual
        return float(found @ found)

    line, *jumps = (course for _, course in _courses(fit, time, np.ptp(time)))
    _, share, p_value = explained(columns(line), fit.residual, basis)
    if not jumps:
        return share, p_value
    _, of_jump, p_jump = explained(columns(max(jumps, key=explains)), fit.residual, basis)
    p_jump = min(1.0, len(jumps) * p_jump)
    return (of_jump, p_jump) if is_drift_significant((of_jump, p_jump)) and of_jump > share else (
        share, p_value)


def _courses(fit: Fit, time: FloatArray, duration: float
             ) -> list[tuple[float | None, FloatArray]]:
    """List ways in which a parameter may go to its last value, as shares of the change left.

    A straight line over the duration [s], or a jump. No jumps where the plant integrates: a law
    that is missing may move one window more than another, and a gain that jumps imitates that.

    Returns:
        When it jumps [s], None for a straight line, and the course, (N,), up to 0.
    """
    first, last = time.min(), time.max()
    count = 0 if fit.candidate.plant.integrates else JUMPS
    at = first + (last - first) * np.arange(1, count + 1) / (count + 1)
    return [(None, (time - last) / duration),
            *((float(jump), -1.0 * (time < jump)) for jump in at)]


def times(fit: Fit, parts: Sequence[Part]) -> FloatArray:
    """Return the stamp of every sample scored, from the first [s]."""
    return np.concatenate([time[fit.candidate.start_up:]
                           for time in _times(parts, fit.candidate.sample_time)])


def _times(parts: Sequence[Part], sample_time: float) -> list[FloatArray]:
    """Return the stamps of each part, from the first sample of all [s]."""
    first = min(part.start for part in parts)
    return [1e-9 * (part.start - first) + sample_time * np.arange(len(part.measured), dtype=float)
            for part in parts]


def drifts(fit: Fit, parts: Sequence[Part], duration: float
           ) -> dict[str, tuple[float, float | None]]:
    """Say how each parameter of the plant would have to drift by itself.

    Args:
        fit: of a model without that drift.
        parts: what was fitted.
        duration: of all that was recorded, held-out data too [s].

    Returns:
        For each parameter that was fitted, by least squares on the residual of the fit: by how
        much of its last value it changes in all, and when it jumps [s] from the first sample, None
        where a straight line explains more.
    """
    fit = fit.main
    basis, time = fit.tangent_basis, times(fit, parts)
    residual = project_out(fit.residual, basis)
    found = {}
    for unknown, slope in zip(fit.unknowns, fit.jacobian.T, strict=True):
        if unknown.owner != '':
            continue
        best = 0.0
        for jump, course in _courses(fit, time, duration):
            column = project_out(slope * course, basis)
            size, along = float(column @ column), float(column @ residual)
            if size > 0.0 and along**2 / size > best:
                best = along**2 / size
                found[unknown.name] = along / size, jump
    return found


def is_drift_significant(found: tuple[float, float]) -> bool:
    """Whether a drift of that share and p-value is one."""
    share, p_value = found
    return share > DRIFTS and p_value < LEVEL


def _groups(candidate: Model) -> list[tuple[int, str, int]]:
    """List (port, signal, row of what is seen), with the value of each port itself."""
    plant = candidate.plant
    groups, at = [], len(plant.ports)
    for index, port in enumerate(plant.ports):
        groups.append((index, 'value', index))
        for name in port.signals:
            groups.append((index, name, at))
            at += 1
    return groups


def _carried(columns: FloatArray, b: FloatArray, a: FloatArray) -> FloatArray:
    """Carry what is added at a port to the output."""
    carried: FloatArray = signal.lfilter(b, np.concatenate([[1.0], a]), columns - columns[:1],
                                         axis=0)
    return carried
