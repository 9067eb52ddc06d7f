"""Is there structure in a residual: does it depend on what passes at the ports, and on time?

At each port, for each signal there, a free curve (hat functions over what the signal reaches) is
added to the port's value and carried to the output by the linear laws. What such a curve explains
of the residual, beyond re-tuning, is a dependence that the model lacks, whatever its law.
"""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal, stats

from hydro_twin.fitting.free_run import START, Candidate, Fit, Part
from hydro_twin.plants.difference_equation import DifferenceEquation, from_state_space
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.system import discretise
from hydro_twin.residual.noise import autoregression

HATS = 9
LEVEL = 1e-4            # of the test, for all dependences together
TIME = 'time'


@dataclass(frozen=True)
class Dependence:
    """What a free curve at one port over one signal explains of a residual.

    Attributes:
        signal: 'value' of the port, a signal there, or time (then port is that of no law: '').
        share: of the residual's power, on the parts that were fitted.
        held_out: the same on parts that were not, by the curve found on those that were.
        p_value: of the share under noise, for all dependences tried.
        knots, curve: the signal and what is added to the value of the port there.
    """

    port: str
    signal: str
    share: float
    held_out: float
    p_value: float
    knots: FloatArray
    curve: FloatArray


def to_output(candidate: Candidate) -> DifferenceEquation:
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


def dependences(fit: Fit, train: Sequence[Part], test: Sequence[Part]) -> list[Dependence]:
    """Find what the residual of a fit depends on, on both parts; the best held out first.

    Only those are returned that noise would hardly give, and that hold on the test parts.
    """
    candidate = fit.candidate
    carry = to_output(candidate)
    seen_train, seen_test = _observe(candidate, train), _observe(candidate, test)
    residuals = np.split(fit.residual, np.cumsum(fit.lengths)[:-1])
    left_over = [candidate.residual(part) for part in test]
    whitener = autoregression(residuals)
    tangent = np.split(fit.jacobian, np.cumsum(fit.lengths)[:-1])
    target = _whitened(residuals, whitener)
    basis, _ = np.linalg.qr(_whitened(tangent, whitener))
    raw_basis, _ = np.linalg.qr(fit.jacobian)
    groups = _groups(candidate)
    found = []
    for port, name, row in groups:
        reach = np.concatenate([seen[:, row] for seen in seen_train])
        low, high = np.quantile(reach, [0.001, 0.999])
        if not high - low > 1e-12 * max(abs(low), abs(high), 1e-300):
            continue
        knots = np.linspace(low, high, HATS)
        filter_ = carry.b[:, port]
        columns = [_carried(hats(seen[:, row], knots), filter_, carry.a) for seen in seen_train]
        weights, share, p_value = _explain(columns, residuals, target, basis, raw_basis, whitener)
        if p_value * len(groups) > LEVEL:
            continue
        unseen = [_carried(hats(seen[:, row], knots), filter_, carry.a) @ weights
                  for seen in seen_test]
        found.append(Dependence(
            candidate.plant.ports[port].name, name, share, _held_out(unseen, left_over),
            min(1.0, p_value * len(groups)), knots, weights))
    return sorted((d for d in found if d.held_out > 0.0), key=lambda d: -d.held_out)


def drift(fit: Fit) -> float:
    """p-value that no parameter drifts over the recording: the tangent times time explains it."""
    cuts = np.cumsum(fit.lengths)[:-1]
    residuals = np.split(fit.residual, cuts)
    whitener = autoregression(residuals)
    time = np.linspace(-1.0, 1.0, len(fit.residual))[:, None]
    columns = np.split(fit.jacobian * time, cuts)
    basis, _ = np.linalg.qr(_whitened(np.split(fit.jacobian, cuts), whitener))
    raw_basis, _ = np.linalg.qr(fit.jacobian)
    _, _, p_value = _explain(columns, residuals, _whitened(residuals, whitener), basis, raw_basis,
                             whitener)
    return p_value


def _groups(candidate: Candidate) -> list[tuple[int, str, int]]:
    """List (port, signal, row of what is seen), with the value of each port itself."""
    plant = candidate.plant
    groups, at = [], len(plant.ports)
    for index, port in enumerate(plant.ports):
        groups.append((index, 'value', index))
        for name in port.signals:
            groups.append((index, name, at))
            at += 1
    return groups


def _observe(candidate: Candidate, parts: Sequence[Part]) -> list[FloatArray]:
    """Run over parts and return what passes at ports and signals."""
    all_seen = []
    for part in parts:
        seen = np.zeros((len(part.inputs), len(candidate.system.O)))
        candidate.run(part, seen)
        all_seen.append(np.nan_to_num(seen))
    return all_seen


def _carried(columns: FloatArray, b: FloatArray, a: FloatArray) -> FloatArray:
    """Carry what is added at a port to the output, scored samples only."""
    carried = signal.lfilter(b, np.concatenate([[1.0], a]), columns - columns[:1], axis=0)
    scored: FloatArray = carried[START:]
    return scored


def _whitened(pieces: Sequence[FloatArray], filter_: FloatArray) -> FloatArray:
    """Filter each piece along time and join them."""
    cut = len(filter_) - 1
    return np.concatenate([signal.lfilter(filter_, 1.0, piece, axis=0)[cut:] for piece in pieces])


def _explain(columns: Sequence[FloatArray], residuals: Sequence[FloatArray], target: FloatArray,
             basis: FloatArray, raw_basis: FloatArray, whitener: FloatArray
             ) -> tuple[FloatArray, float, float]:
    """Regress the whitened residual on columns, both less the tangent; weights, share, p-value."""
    white = _whitened(columns, whitener)
    white = white - basis @ (basis.T @ white)
    rest = target - basis @ (basis.T @ target)
    scale = np.linalg.norm(white, axis=0)
    scale[scale <= 1e-9 * scale.max(initial=0.0)] = np.inf
    U, sizes, Vt = np.linalg.svd(white / scale, full_matrices=False)
    kept = sizes > 0.03 * sizes.max(initial=0.0)
    along = U[:, kept].T @ rest
    explained, power = float(along @ along), float(rest @ rest)
    degrees = int(kept.sum())
    freedom = len(rest) - degrees - basis.shape[1]
    if degrees == 0 or freedom <= 0 or power <= explained:
        return np.zeros(white.shape[1]), 0.0, 1.0
    statistic = (explained / degrees) / ((power - explained) / freedom)
    weights = (Vt[kept].T @ (along / sizes[kept])) / scale
    raw = np.concatenate(list(residuals))
    moved = np.concatenate(list(columns)) @ weights
    moved = moved - raw_basis @ (raw_basis.T @ moved)
    share = 1.0 - float(np.sum((raw - moved) ** 2) / np.sum(raw**2))
    log_p = float(stats.f.logsf(statistic, degrees, freedom))
    return weights, max(share, 0.0), math.exp(max(log_p, -700.0))


def _held_out(predicted: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> float:
    """Share of the test residual's power that a prediction takes off, best scale left out."""
    before = sum(float(np.sum((r - r.mean()) ** 2)) for r in residuals)
    after = sum(float(np.sum((r - p - (r - p).mean()) ** 2))
                for r, p in zip(residuals, predicted, strict=True))
    return 1.0 - after / before if before > 0.0 else 0.0
