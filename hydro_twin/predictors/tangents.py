"""How a step follows unknowns: derivatives of its matrices, and which column is which unknown."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_twin.compiled import compiled
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.rows import in_rows
from hydro_twin.predictors.system import discretise, port_rows, System

COMPLEX_STEP = 1e-20
NODES = 9               # at most: a parameter that more than doubles turns the derivatives by 2 %
APART = 0.1             # logarithm of a parameter between nodes, where fewer do


class Tangent(NamedTuple):
    """How a step follows D unknowns.

    Derivatives are rows of D columns, as `Rows` are.

    Attributes:
        rows: those of `TangentRows`, one after another.
        moves: which elements of H have any, of its shape.
        shifts: the inputs of which that moves how late they act.
        compliance: how far the first signal of each implicit effect rises for a unit added, (K,).
        moving: whether the matrices move at all.
        rest: the first of K columns for what the laws vary beside a line, where the derivatives of
            a state are a root of its covariance; -1 where they are but derivatives.
    """

    rows: FloatArray
    moves: npt.NDArray[np.bool_]
    shifts: npt.NDArray[np.int64]
    compliance: FloatArray
    moving: bool
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
    moves: npt.NDArray[np.bool_]
    shifts: npt.NDArray[np.int64]
    compliance: FloatArray
    moving: bool
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
                       rows[compliance:], tangent.moves, tangent.shifts, tangent.compliance,
                       tangent.moving, tangent.rest)


@dataclass(frozen=True)
class Directions:
    """Unknowns by which a run is differentiated, each in its own unit.

    Attributes:
        plant: names of parameters with what one unit of the unknown is worth, Q of them.
        p: (index in the effects' parameters, worth) for each unknown of an effect.
        shift: for each unknown of the timing how it moves each input [samples], (T, m).
    """

    plant: Sequence[tuple[str, float]] = ()
    p: Sequence[tuple[int, float]] = ()
    shift: npt.ArrayLike = ()

    @property
    def count(self) -> int:
        """How many."""
        return len(self.plant) + len(self.p) + len(np.asarray(self.shift))


NONE = Directions()


Moves = Mapping[str, FloatArray]        # parameter -> derivative of [M; H], padded


def moves_of(system: System, names: Iterable[str]) -> Moves:
    """Differentiate M and H, one above the other, by parameters, each in its own unit."""
    step, every = system.step, list(names)
    if not every:
        return {}
    units = COMPLEX_STEP * np.array([system.values[name] for name in every])
    beside: Mapping[str, Any] = {**system.values, **{
        name: system.values[name] + 1j * (units * row)[:, None]
        for name, row in zip(every, np.eye(len(every)), strict=True)}}
    laws = system.plant.laws(beside)
    M, H = discretise(laws, step.sample_time / step.substeps), port_rows(laws)
    found = np.zeros((len(every), M.shape[1] + H.shape[1], M.shape[2]))
    found[:, :M.shape[1]] = M.imag
    found[:, M.shape[1]:, :H.shape[2]] = H.imag
    return dict(zip(every, found / units[:, None, None], strict=True))


def tangents_of(system: System, by: Callable[[System], Directions]) -> list[Tangent]:
    """Differentiate the step of every stage of a system.

    The matrices go smoothly with a parameter that drifts, so that their derivatives are taken at
    up to `NODES` of its values and interpolated.

    Args:
        system: what is run.
        by: the unknowns at a stage.
    """
    stages, directions = system.stages, [by(stage) for stage in system.stages]
    names = dict.fromkeys(name for name, _ in directions[-1].plant)
    way = np.cumsum([0.0, *(max(abs(math.log(then / now)) for now, then in zip(
        before.values.values(), after.values.values(), strict=True))
        for before, after in pairwise(stages))])
    count = min(NODES, 2 + int(way[-1] / APART))
    nodes = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], count)))
    moves = [moves_of(stages[k], names) for k in nodes]
    shares = np.column_stack([np.interp(way, way[nodes], row) for row in np.eye(len(nodes))])
    return [tangent_of(stage, some, {
        name: sum(share * at[name] for share, at in zip(row, moves, strict=True) if share)
        for name in names}) for stage, some, row in zip(stages, directions, shares, strict=True)]


def tangent_of(system: System, by: Directions, moves: Moves | None = None) -> Tangent:
    """Differentiate the matrices of a step, with columns for the state at the start.

    Args:
        system: what is run.
        by: the unknowns; the columns are those of the plant, of the effects, of the timing.
        moves: what the parameters do to the matrices, if that is known.
    """
    step, starts = system.step, len(system.laws.A) + len(lasting(system))
    Q, D = len(by.plant), by.count + starts
    dM, dH = np.zeros((*step.M.shape, D)), np.zeros((*step.H.shape, D))
    if moves is None:
        moves = moves_of(system, dict.fromkeys(name for name, _ in by.plant))
    for q, (name, worth) in enumerate(by.plant):
        dM[..., q] = worth * moves[name][:len(step.M)]
        dH[..., q] = worth * moves[name][len(step.M):, :step.H.shape[1]]
    p, shift = np.zeros((len(step.p), D)), np.zeros((len(step.shift), D))
    for q, (index, worth) in enumerate(by.p):
        p[index, Q + q] = worth
    at = Q + len(by.p)
    shift[:, at:by.count] = np.reshape(np.asarray(by.shift, dtype=np.float64),
                                       (by.count - at, len(shift))).T
    n, m, P = len(system.laws.A), len(step.shift), len(system.plant.ports)
    compliance, rises = np.zeros(len(step.effects)), np.zeros((len(step.effects), D))
    for e, effect in enumerate(step.effects):
        if effect['implicit']:
            begin = n + 2 * m + effect['port']
            row, both = step.H[effect['signal_0'], :n], step.M[:, [begin, begin + P]].sum(axis=1)
            compliance[e] = row @ both
            rises[e] = (both @ dH[effect['signal_0'], :n]
                        + row @ dM[:, [begin, begin + P]].sum(axis=1))
    rows = np.concatenate([dM.reshape(-1, D), dH.reshape(-1, D), p, shift, rises])
    return Tangent(in_rows(rows), dH.any(axis=2), np.flatnonzero(shift.any(axis=1)), compliance,
                   bool(dM.any()), -1)


def lasting(system: System) -> npt.NDArray[np.int64]:
    """Index the memory that lasts: not what an implicit effect keeps, which is soon over."""
    return np.array([k for effect in system.step.effects if not effect['implicit']
                     for k in range(effect['z_begin'], effect['z_end'])], dtype=np.int64)
