"""Slowly varying parameters, followed by the observer as random-walk states.

Each state is the logarithm of a parameter over its value in the model. The matrices of the step
are updated to first order in it, and recomputed where that is no longer accurate. A drift in the
model is then left out: its last values hold throughout, and the observer follows the change.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray
from hydro_twin.compiled import compiled
from hydro_twin.errors import ModelError
from hydro_twin.predictors.kernel import Step
from hydro_twin.predictors.rows import add, clear, in_rows, put, WIDTH
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import Directions, Tangent, tangent_of

if TYPE_CHECKING:
    from hydro_twin.model import Model

RATE = 0.05             # relative change over the root of a second: 40 % in a minute
UNSURE = 0.1            # relative error of a parameter whose standard error is not known
FAR = 0.05              # the square of so small a change moves no matrix by more than 0.2 %


class Slow(NamedTuple):
    """The followed parameters of one run, Q of them, and how the step depends on them.

    Attributes:
        now: logarithm of each over its value in the model, (Q,).
        at: `now` when the matrices were last computed.
        far: largest distance from `at` at which they are used; infinite for those of an effect.
        low, high: bounds of `now`.
        entry: index of an effect's parameter among those of the step; -1: one of the plant.
        p: value of an effect's parameter in the model.
        M, H, compliance: of the step, as last computed.
        M_slopes, H_slopes, compliance_slopes: their derivatives, (Q, how many).
    """

    now: FloatArray
    at: FloatArray
    far: FloatArray
    low: FloatArray
    high: FloatArray
    entry: npt.NDArray[np.int64]
    p: FloatArray
    M: FloatArray
    H: FloatArray
    compliance: FloatArray
    M_slopes: FloatArray
    H_slopes: FloatArray
    compliance_slopes: FloatArray


@compiled
def moved(values, rows, base, slopes, slow, walking):  # type: ignore[no-untyped-def]
    """Set values to base plus what the parameters add, and their derivatives likewise."""
    for i in range(len(base)):
        value = base[i]
        clear(rows, i)
        for c in range(len(slow.now)):
            if slopes[c, i] != 0.0:
                value += slopes[c, i] * (slow.now[c] - slow.at[c])
                add(rows, i, slopes[c, i], walking, c)
        values[i] = value


@compiled
def follow_by(step, tangent, slow, walking):  # type: ignore[no-untyped-def]
    """Move a step and its derivatives to where the parameters are now."""
    moved(step.M.reshape(-1), tangent.M, slow.M, slow.M_slopes, slow, walking)
    moved(step.H.reshape(-1), tangent.H, slow.H, slow.H_slopes, slow, walking)
    moved(tangent.compliance, tangent.d_compliance, slow.compliance, slow.compliance_slopes, slow,
          walking)
    for c in range(len(slow.now)):
        if slow.entry[c] >= 0:
            step.p[slow.entry[c]] = slow.p[c] * math.exp(slow.now[c])
            put(tangent.p, slow.entry[c], step.p[slow.entry[c]], walking, c)


@dataclass(frozen=True)
class Followed:
    """The parameters of a model that its observer follows.

    Attributes:
        names: `B_m`, or `friction@motor:coulomb` of an effect.
        base: their values in the model.
        rate: relative change, over the root of a second.
        start: relative standard error at the start.
        low, high: logarithms of the physical range over the value.
        index: of a parameter of an effect among those of the step; -1: one of the plant.
    """

    model: Model
    system: System
    names: tuple[str, ...]
    base: FloatArray
    rate: FloatArray
    start: FloatArray
    low: FloatArray
    high: FloatArray
    index: npt.NDArray[np.int64]

    def in_units(self, logarithms: FloatArray) -> FloatArray:
        """Turn logarithms and their standard deviations, (2, Q), into values and errors."""
        values = self.base * np.exp(logarithms[0])
        return np.array([values, values * logarithms[1]])

    def slow(self) -> Slow:
        """Begin a run."""
        step, count = self.system.step, len(self.names)
        return Slow(np.zeros(count), np.zeros(count), np.where(self.index < 0, FAR, math.inf),
                    self.low.copy(), self.high.copy(), self.index.copy(), self.base.copy(),
                    *(np.zeros(size) for size in (step.M.size, step.H.size, len(step.effects))),
                    *(np.zeros((count, size))
                      for size in (step.M.size, step.H.size, len(step.effects))))

    def stage(self, slow: Slow, columns: int) -> tuple[Step, Tangent]:
        """Make the matrices for where the parameters are now, and the step that moves with them.

        Args:
            slow: of the run.
            columns: of the covariance, before those for the laws.
        """
        model, factors = self.model, np.exp(slow.now)
        values = {**model.values, **{
            name: float(base * factor) for name, base, factor, index in
            zip(self.names, self.base, factors, self.index, strict=True) if index < 0}}
        effects = tuple(placed for placed in model.effects if placed.effect.course is None)
        system = replace(model, values=values, effects=effects).system
        of_plant = np.flatnonzero(self.index < 0)
        tangent = tangent_of(system, Directions(
            plant=[(self.names[c], values[self.names[c]]) for c in of_plant]))
        step, K = system.step, len(system.step.effects)
        slow.at[:] = slow.now
        slow.M[:], slow.H[:], slow.compliance[:] = (
            step.M.ravel(), step.H.ravel(), tangent.compliance)
        count = len(tangent.rows)
        by = tangent.rows.reshape(count, -1)[:, :len(of_plant)].T
        slow.M_slopes[of_plant], slow.H_slopes[of_plant] = np.split(
            by[:, :step.M.size + step.H.size], [step.M.size], axis=1)
        slow.compliance_slopes[of_plant] = by[:, count - K:]
        width = math.ceil((columns + K) / WIDTH) * WIDTH
        moves = slow.H_slopes.any(axis=0).reshape(step.H.shape)
        return (step._replace(M=step.M.copy(), H=step.H.copy(), p=step.p.copy()),
                Tangent(in_rows(np.zeros((count, width))), moves, tangent.shifts,
                        tangent.compliance.copy(), bool(slow.M_slopes.any()), columns))


def parse(entries: Sequence[str]) -> dict[str, float]:
    """Read what is to be followed, each NAME or NAME=RATE.

    Raises:
        ModelError: a rate is not a positive number.
    """
    found = {}
    for entry in filter(None, entries):
        name, _, rate = entry.partition('=')
        try:
            found[name] = float(rate) if rate else RATE
        except ValueError:
            found[name] = math.nan
        if not 0.0 < found[name] < math.inf:
            raise ModelError(f'follow: {entry}: the rate, relative and over the root of a second, '
                             'must be a positive number')
    return found


def followed_of(model: Model, system: System, rates: Mapping[str, float]) -> Followed | None:
    """Find what a model is to follow, at these rates.

    Raises:
        ModelError: it has no such parameter, or one whose logarithm has no meaning.
    """
    if not rates:
        return None
    own = {p.name: p for p in model.plant.parameters}
    entries: list[tuple[float, float | None, float, float, int]] = []
    theirs = {}
    for index, (placed, begin) in enumerate(zip(model.effects, system.begins, strict=True)):
        for k, p in enumerate(placed.effect.parameters):
            value = placed.values[k]
            if begin >= 0 and p.log and 0.0 < value < math.inf and value != p.refinement:
                theirs[f'{placed.effect.id}@{placed.port.name}:{p.name}'] = (
                    value, model.record.std_error(index, p.name), p.lower, p.upper, begin + k)
    for name in rates:
        if name in own:
            estimate, parameter = model.parameters[name], own[name]
            entries.append((estimate.value, estimate.std_error, parameter.minimum,
                            parameter.maximum, -1))
        elif name in theirs:
            entries.append(theirs[name])
        else:
            raise ModelError(f'follow: {model.plant.name} has no parameter {name} to follow; it '
                             f'has {", ".join([*own, *theirs])}')
    base = np.array([entry[0] for entry in entries])
    errors = np.array([entry[1] / entry[0] if entry[1] else UNSURE for entry in entries])
    return Followed(
        model, system, tuple(rates), base, np.array(list(rates.values())),
        np.minimum(errors, 1.0), np.log([entry[2] / entry[0] for entry in entries]),
        np.log([entry[3] / entry[0] for entry in entries]),
        np.array([entry[4] for entry in entries]))
