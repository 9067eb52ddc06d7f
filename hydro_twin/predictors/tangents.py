"""How a step follows unknowns: derivatives of its matrices, and which column is which unknown."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray
from hydro_twin.compiled import compiled
from hydro_twin.predictors.rows import WIDTH, zeros
from hydro_twin.predictors.system import discretise, port_rows, System

COMPLEX_STEP = 1e-20
NODES = 9               # at most: a parameter that more than doubles turns the derivatives by 2 %
APART = 0.1             # logarithm of a parameter between nodes, where fewer do


class Tangent(NamedTuple):
    """How a step follows D unknowns.

    Derivatives are rows of D columns, as `Rows` are.

    Attributes:
        rows: those of `TangentRows`, one after another.
        H_varies: which elements of H depend on an unknown, in the shape of H.
        shifts: indices of the inputs whose delay depends on an unknown.
        compliance: how far the first signal of each implicit effect rises for a unit added, (K,).
        M_varies: whether M depends on an unknown.
        rest: the first of K columns for the residuals of the linearised laws, where the columns
            are those of a covariance root; -1 where they are plain derivatives.
    """

    rows: FloatArray
    H_varies: npt.NDArray[np.bool_]
    shifts: npt.NDArray[np.int64]
    compliance: FloatArray
    M_varies: bool
    rest: int


class TangentRows(NamedTuple):
    """A tangent with its rows split by what they belong to.

    Attributes:
        M, H: derivatives of the matrices of the step, element after element.
        p: of the effects' parameters.
        shift: of how late inputs act [samples].
        d_compliance: of the compliance.
    """

    M: FloatArray
    H: FloatArray
    p: FloatArray
    shift: FloatArray
    d_compliance: FloatArray
    H_varies: npt.NDArray[np.bool_]
    shifts: npt.NDArray[np.int64]
    compliance: FloatArray
    M_varies: bool
    rest: int


@compiled
def split_rows(step, tangent):  # type: ignore[no-untyped-def]
    """Return the `TangentRows` of a tangent, in compiled code, which passes one array faster."""
    H = step.M.size
    p = H + step.H.size
    shift = p + len(step.p)
    compliance = shift + len(step.shift)
    rows = tangent.rows
    return TangentRows(rows[:H], rows[H:p], rows[p:shift], rows[shift:compliance],
                       rows[compliance:], tangent.H_varies, tangent.shifts, tangent.compliance,
                       tangent.M_varies, tangent.rest)


@dataclass(frozen=True)
class Directions:
    """Unknowns by which a run is differentiated, each in its own unit.

    Attributes:
        plant: names of parameters with what one unit of the unknown is worth, Q of them: at each
            of the K stages of a system, (K,), or the same at all.
        p: (index in the effects' parameters, worth) for each unknown of an effect.
        shift: for each unknown of the timing how it moves each input [samples], (T, m).
    """

    plant: Sequence[tuple[str, float | FloatArray]] = ()
    p: Sequence[tuple[int, float]] = ()
    shift: npt.ArrayLike = ()

    @cached_property
    def count(self) -> int:
        """How many."""
        return len(self.plant) + len(self.p) + len(np.asarray(self.shift))


NONE = Directions()


def matrix_derivatives(system: System, names: Sequence[str]) -> FloatArray:
    """Differentiate M and H, one above the other, by parameters, each in its own unit, (Q, ...).

    The rows of H are padded to the width of M.
    """
    step = system.step
    units = COMPLEX_STEP * np.array([system.values[name] for name in names])
    beside: Mapping[str, Any] = {**system.values, **{
        name: system.values[name] + 1j * (units * row)[:, None]
        for name, row in zip(names, np.eye(len(names)), strict=True)}}
    laws = system.plant.laws(beside)
    M, H = discretise(laws, step.sample_time / step.substeps), port_rows(laws)
    found = np.zeros((len(names), len(step.M) + len(step.H), step.M.shape[1]))
    found[:, :len(step.M)] = M.imag
    found[:, len(step.M):, :H.shape[2]] = H.imag
    found /= units[:, None, None]
    return found


def tangents_of(system: System, by: Directions) -> list[Tangent]:
    """Differentiate the step of every stage of a system, with columns for the initial state.

    Args:
        system: what is run.
        by: the unknowns; the columns are those of the plant, of the effects, of the timing.
    """
    return _tangents(system.stages, by)


def tangent_of(system: System, by: Directions) -> Tangent:
    """Differentiate the step of a system as it is now, see `tangents_of`."""
    return _tangents([system], by)[0]


def _moves_at(stages: Sequence[System], names: Sequence[str]) -> FloatArray:
    """Differentiate M and H of K stages, see `matrix_derivatives`, (K, Q, ...).

    The matrices go smoothly with a parameter that drifts, so that their derivatives are taken at
    up to `NODES` of its values and interpolated.
    """
    if len(stages) == 1:
        return matrix_derivatives(stages[0], names)[None]
    way = np.cumsum([0.0, *(max(abs(math.log(then / now)) for now, then in zip(
        before.values.values(), after.values.values(), strict=True))
        for before, after in pairwise(stages))])
    count = min(NODES, 2 + int(way[-1] / APART))
    nodes = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], count)))
    shares = np.column_stack([np.interp(way, way[nodes], row) for row in np.eye(len(nodes))])
    found: FloatArray = np.tensordot(
        shares, np.stack([matrix_derivatives(stages[k], names) for k in nodes]), 1)
    return found


def _tangents(stages: Sequence[System], by: Directions) -> list[Tangent]:
    """Differentiate the steps of K systems that differ by parameters only.

    Args:
        stages: the systems.
        by: the unknowns.
    """
    step, n, m = stages[-1].step, len(stages[-1].laws.A), len(stages[-1].step.shift)
    K, Q, D = len(stages), len(by.plant), by.count + n + len(lasting(stages[-1]))
    sizes = [step.M.size, step.H.size, len(step.p), m, len(step.effects)]
    every = zeros(K * sum(sizes), math.ceil(D / WIDTH)).reshape(K, sum(sizes), -1)
    dM, dH, p, shift, rises = np.split(every, np.cumsum(sizes)[:-1], axis=1)
    dM, dH = dM.reshape(K, *step.M.shape, -1), dH.reshape(K, *step.H.shape, -1)
    if Q:
        order = [name for name, _ in by.plant]
        names = list(dict.fromkeys(order))
        worths = np.stack([np.broadcast_to(worth, K) for _, worth in by.plant], axis=1)
        rows = np.moveaxis(_moves_at(stages, names)[:, [names.index(name) for name in order]]
                           * worths[..., None, None], 1, -1)
        dM[..., :Q], dH[..., :Q] = rows[:, :len(step.M)], rows[:, len(step.M):, :step.H.shape[1]]
    for q, (index, worth) in enumerate(by.p):
        p[:, index, Q + q] = worth
    at = Q + len(by.p)
    shift[:, :, at:by.count] = np.reshape(np.asarray(by.shift, dtype=np.float64),
                                          (by.count - at, m)).T
    P = len(stages[-1].plant.ports)
    compliance = np.zeros((K, len(step.effects)))
    for e, effect in enumerate(step.effects):
        if effect['implicit']:
            begin, signal = n + 2 * m + effect['port'], effect['signal_0']
            row = np.stack([stage.step.H[signal, :n] for stage in stages])
            both = np.stack([stage.step.M[:, [begin, begin + P]] for stage in stages]).sum(axis=2)
            moved = dM[:, :, [begin, begin + P]].sum(axis=2)
            compliance[:, e] = np.einsum('ki,ki->k', row, both)
            rises[:, e] = (np.einsum('ki,kid->kd', both, dH[:, signal, :n])
                           + np.einsum('ki,kid->kd', row, moved))
    shifts = np.flatnonzero(shift[0].any(axis=1))
    M_varies, H_varies = dM.any(axis=(1, 2, 3)).tolist(), dH.any(axis=3)
    return [Tangent(every[k].reshape(sum(sizes), -1, WIDTH), H_varies[k], shifts, compliance[k],
                    M_varies[k], -1) for k in range(K)]


def lasting(system: System) -> npt.NDArray[np.int64]:
    """Index the memory that lasts: not what an implicit effect keeps, which is soon over."""
    return np.array([k for effect in system.step.effects if not effect['implicit']
                     for k in range(effect['z_begin'], effect['z_end'])], dtype=np.int64)
