"""Least squares of many recordings by their triangular factors, without the recordings.

Of the parameters x of a rig, a trace keeps as much as its recording says: rows R and z such that
|R x - z|^2 is twice the negative log-likelihood near its estimate, up to a constant. Those of
several recordings are stacked, and factored again. Where the output is linear in x this is the
fit to all recordings together; else a Gauss-Newton step towards it.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.stats import chi2

from hydro_twin.arrays import FloatArray
from hydro_twin.fleet.scores import BoolArray

WIDE = 3.0              # of what is eliminated: a factor of 20 up or down; wider than search boxes


@dataclass(frozen=True)
class Rows:
    """What recordings say of p parameters.

    Attributes:
        R: (k, p).
        z: (k,).
    """

    R: FloatArray
    z: FloatArray

    def without(self, columns: Sequence[int], at: FloatArray, log: Sequence[bool] | BoolArray
                ) -> Rows:
        """Eliminate parameters; their columns are zero then.

        Each is taken to be `WIDE` about its estimate. If it could be anything, those that go
        along with it ever so little would be lost, too.

        Args:
            columns: which ones, (c,).
            at: (c,), their estimates.
            log: whether by the logarithm, (c,).
        """
        if not len(columns):
            return self
        width = WIDE * np.where(log, 1.0, np.where(at == 0.0, 1.0, np.abs(at)))
        R = np.vstack([self.R, np.eye(self.R.shape[1])[columns] / width[:, None]])
        free = null_space(R[:, columns].T).T
        R = free @ R
        R[:, columns] = 0.0
        return Rows(R, free @ np.concatenate([self.z, at / width]))

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Return estimate and covariance; of what is not determined, the shortest, and nan."""
        scale = np.linalg.norm(self.R, axis=0)
        unknown = scale == 0.0
        scale[unknown] = 1.0
        inverse = np.linalg.pinv(self.R / scale) / scale[:, None]
        covariance = inverse @ inverse.T
        covariance[unknown] = covariance[:, unknown] = np.nan
        return inverse @ self.z, covariance


def rows_of(factor: Mapping[str, Any], names: Sequence[str], log: Sequence[bool]) -> Rows:
    """Take the rows of a trace about some parameters, by their logarithm where asked.

    Others are eliminated, and so is what has no logarithm.

    Args:
        factor: of the record of a trace: names, values at which it was linearised (p,), rows
            (k, p) by the parameters in their units, step (k,), see `result.Factor`.
        names: of the columns.
        log: which of these are taken by their logarithm.
    """
    own, values = factor['names'], np.array(factor['values'])
    R, step = np.array(factor['rows']).reshape(-1, len(own)), np.array(factor['step'])
    by_log = dict(zip(names, log, strict=True))
    logs = np.array([by_log.get(name, value > 0.0) for name, value in
                     zip(own, values, strict=True)], dtype=bool)
    at = np.where(logs, np.log(np.where(values > 0.0, values, 1.0)), values)
    R = R * np.where(logs, values, 1.0)
    others = [k for k, name in enumerate(own)
              if name not in by_log or (by_log[name] and values[k] <= 0.0)]
    rows = Rows(R, R @ at + step).without(others, at[others], logs[others])
    columns = np.zeros((len(rows.z), len(names)))
    for k, name in enumerate(names):
        if name in own:
            columns[:, k] = rows.R[:, own.index(name)]
    return Rows(columns, rows.z)


def together(parts: Sequence[Rows]) -> tuple[Rows, float]:
    """Combine recordings of one rig.

    Returns:
        p rows or fewer, and how probable it is that recordings of the same parameters differ by
        more.
    """
    R, z = (np.concatenate(some) for some in zip(*((part.R, part.z) for part in parts),
                                                 strict=True))
    p = R.shape[1]
    whole = np.linalg.qr(np.column_stack([R, z]), mode='r')
    rows = Rows(whole[:p, :p], whole[:p, p])
    x, _ = rows.solve()
    free = len(z) - np.linalg.matrix_rank(R / np.maximum(np.linalg.norm(R, axis=0), 1e-300))
    return rows, float(chi2.sf(np.sum((R @ x - z) ** 2), free)) if free else 1.0
