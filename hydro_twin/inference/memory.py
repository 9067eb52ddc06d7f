"""Combination of a fit to a new recording with the earlier recordings of the same rig.

A rig that has worn differs from that of its earlier recordings: one fit to all of them would find
a mean of the two. Parameters that have not changed are estimated from both, the others from the
new recording alone. This is a joint fit of two rigs with shared parameters, linearised about the
model of each.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from statistics import NormalDist

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.identifiability import Identifiability, NULL
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.regression import triangle
from hydro_twin.fitting.unknowns import coordinates_of, effect_unknowns, label, Unknown
from hydro_twin.model import Model
from hydro_twin.predictors.scores import rms

CHANCE = 0.01           # that anything is said to have moved on a rig that did not change


@dataclass(frozen=True)
class CombinedFit:
    """A fit to a new recording that keeps what is known from earlier ones.

    Attributes:
        fit: with the new values, on the parts of the new recording.
        known: what all recordings together determine of it.
        moved: the unknowns that are others now, beyond the errors of both.
    """

    fit: Fit
    known: Identifiability
    moved: tuple[Unknown, ...]


def combine_with_earlier(fit: Fit, parts: Sequence[Part], before: Model, earlier: Sequence[Part]
                         ) -> CombinedFit:
    """Join what a fit found in a new recording with what earlier ones say of the model before.

    An unknown that moved between them beyond the standard errors of both, by a two-sided z-test
    at `CHANCE` for all together (Bonferroni), is left to the new recording. One that only one of
    them determines has not moved as far as is known.

    Args:
        fit: to the new recording, from the model before on.
        parts: what it was fitted to.
        before: that model, with its effects in front of those that the fit has added.
        earlier: stretches of the recordings that the model before came from.
    """
    shared = _shared(fit, before)
    if not shared:
        return CombinedFit(fit, fit.identifiability(), ())
    problem = Problem(before, [fit.unknowns[k] for k in shared], earlier)
    then = problem.unsearched()
    here = coordinates_of(fit.candidate, fit.unknowns)
    change = here[shared] - coordinates_of(before, problem.unknowns)
    moved = _moved(change, problem.unknowns, fit.identifiability(), then.identifiability())
    kept = [k for k in range(len(shared)) if k not in moved]
    rows = _apart(then.jacobian, kept, moved) / rms(then.residual)
    step = _step(fit, rows, [shared[k] for k in kept], -change[kept])
    again = Problem(fit.candidate, fit.unknowns, parts)
    found = again.fit(again.at(np.clip(here + step, *again.bounds())))
    return CombinedFit(found, _known(found, then, rows, [shared[k] for k in kept]),
                       tuple(problem.unknowns[k] for k in moved))


def named(candidate: Model, unknown: Unknown) -> str:
    """Name an unknown for a person, as 'J' or 'coulomb of the friction'."""
    if not unknown.owner.isdecimal():
        return f'timing of {unknown.name}' if unknown.owner else unknown.name
    effect = candidate.effects[int(unknown.owner)].effect
    return f'{unknown.name} of the {effect.id}'.replace('_', ' ')


def _shared(fit: Fit, before: Model) -> list[int]:
    """List the unknowns of a fit that the model before has, too, and that are free in both."""
    had = {label(u) for index, placed in enumerate(before.effects)
           for u in effect_unknowns(index, placed)
           if index < len(fit.candidate.effects)
           and (placed.effect, placed.port) == (fit.candidate.effects[index].effect,
                                                fit.candidate.effects[index].port)}
    fixed = fit.at_bound()
    return [k for k, u in enumerate(fit.unknowns)
            if label(u) not in fixed and (not u.owner.isdecimal() or label(u) in had)]


def _moved(change: FloatArray, unknowns: Sequence[Unknown], now: Identifiability,
           then: Identifiability) -> list[int]:
    """List the unknowns that changed beyond the errors of both recordings."""
    limit = NormalDist().inv_cdf(1.0 - 0.5 * CHANCE / len(unknowns))
    errors = [[one.std_error.get(label(u)) for one in (now, then)] for u in unknowns]
    return [k for k, (a, b) in enumerate(errors)
            if a is not None and b is not None and abs(change[k]) > limit * math.hypot(a, b)]


def _apart(slopes: FloatArray, kept: Sequence[int], moved: Sequence[int]) -> FloatArray:
    """Take out of some columns what others can do as well, since those are free, (N, kept)."""
    free = np.linalg.qr(slopes[:, moved])[0]
    rows: FloatArray = slopes[:, kept]
    return rows - free @ (free.T @ rows)


def _step(fit: Fit, rows: FloatArray, columns: Sequence[int], target: FloatArray) -> FloatArray:
    """Step from the optimum of the new recording to that of all, weighted by their noise.

    Args:
        fit: at the optimum of the new recording.
        rows: slopes of the earlier ones over their residual, (N, kept).
        columns: which unknowns of the fit these are.
        target: the step that the earlier ones ask for, (kept,).
    """
    then = np.zeros((len(columns), len(fit.unknowns)))
    then[:, columns] = triangle([rows])
    now = triangle([fit.jacobian / rms(fit.residual)])
    step: FloatArray = np.linalg.lstsq(
        np.vstack([now, then]),
        np.concatenate([np.zeros(len(now)), then[:, columns] @ target]), rcond=NULL)[0]
    return step


def _known(fit: Fit, then: Fit, rows: FloatArray, columns: Sequence[int]) -> Identifiability:
    """Say what all recordings determine, those of less noise with more weight; see `_step`."""
    earlier = np.zeros((len(rows), len(fit.unknowns)))
    size = rms(fit.residual)
    earlier[:, columns] = size * rows
    return Fit(fit.candidate, fit.unknowns,
               np.concatenate([fit.residual, size / rms(then.residual) * then.residual]),
               np.vstack([fit.jacobian, earlier]), (*fit.lengths, *then.lengths),
               fit.penalty).identifiability()
