"""The search for the unknowns of a model, by its output error over parts of a recording."""
from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
import math

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.elimination import eliminate, eliminate_with_reruns, Eliminated
from hydro_twin.fitting.first_samples import FirstSamples
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.initial_states import InitialStates
from hydro_twin.fitting.output_error import initial_states, linear_response
from hydro_twin.fitting.outputs import Layout, Pieces, sensors_in, Stack
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.regression import triangle
from hydro_twin.fitting.unknowns import coordinates_of, get, log_search_box, put, Unknown
from hydro_twin.model import Model
from hydro_twin.parallel import in_processes
from hydro_twin.predictors.sensitivities import FREE, OutputFeedback, run_with_sensitivities
from hydro_twin.predictors.tangents import Directions, tangents_of

BOX = 3e-3              # weight of the search box, see `Problem`
MIDDLE = 1e-4           # and of its middle
INSIDE = 1e-9           # distance to a bound, relative
REWEIGHTED = 2          # further searches with new weights; they settle after one, or hardly
RESCALED = 8          # and of sensors with new scales
SAME_SCALE = 0.02       # change of the logarithm of a scale that hardly moves the fit
SAME_WEIGHT = 2.0       # ratio of two weights that give nearly the same start
DIVERGED = 1e3          # movements of the output: residual of a run that diverged
LONGEST_STEP = 1.0      # of a coordinate, in one step: a factor of e
PATIENCE = 5            # evaluations: the radius has shrunk a thousandfold, and no step is better
CONVERGED = 'converged'


@dataclass(frozen=True)
class Evaluation:
    """A run over all parts at some values of the unknowns, as where a search ended.

    Attributes:
        coordinates: of the unknowns, (d,).
        residual: of all parts, scored samples only, filtered where there are filters, (N,).
        jacobian: derivatives of the output by the coordinates, filtered as the residual, (N, d).
        weights: of the first samples of each part.
        scales: of output and sensors, (1 + K,).
        penalty: of the coordinates, to be squared, (2 d,).
        initial: the initial states of the parts.
        reason: of stopping.
    """

    coordinates: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    weights: FloatArray
    scales: FloatArray
    penalty: FloatArray
    initial: InitialStates
    reason: str = ''

    @property
    def sum_of_squares(self) -> float:
        """Sum of squares of residual and penalty, which a search lowers."""
        return float(self.residual @ self.residual + self.penalty @ self.penalty)


class _StalledError(Exception):
    """No step lowers the sum of squares any more."""


class Problem:
    """The search for unknowns on parts, by the residual of the free run.

    Where the data do not determine a direction, or the lack of an effect biases the fit, a search
    would run off to values no rig has. So leaving the search box by a factor of e costs as much
    as an error of 0.3 % of the output throughout, and a still weaker penalty keeps to its middle
    (for effects, to where the search starts).

    The initial states of the parts are unknowns, too, which are eliminated.

    Args:
        base: from where the search begins.
        unknowns: what is searched.
        parts: what is fitted.
        gain: of an output feedback, see `OutputFeedback`; None: the runs are free.
    """

    def __init__(self, base: Model, unknowns: Sequence[Unknown], parts: Sequence[Part],
                 gain: FloatArray | None = None) -> None:
        self.base = base
        self.gain = gain
        self.unknowns = tuple(unknowns)
        self.parts = parts
        self.sensors = sensors_in(parts, base.plant, base.start_up)
        self.stacks = [Stack.of(part, self.sensors, base.start_up) for part in parts]
        self.pieces = Pieces.of(self.stacks)
        self.size, self.lengths = float(self.pieces.sizes[0]), self.pieces.lengths
        box = log_search_box(base.plant)
        edges = [box[u.name] if u.owner == '' else (-math.inf, math.inf) for u in self.unknowns]
        self.low, self.high = np.array(edges).T
        starts = coordinates_of(base, self.unknowns)
        self.middle = np.array([0.5 * (low + high) if math.isfinite(low) else start
                                for (low, high), start in zip(edges, starts, strict=True)])

    @cached_property
    def layout(self) -> Layout:
        """The parts one after another."""
        return Layout.of(self.parts, self.stacks)

    @cached_property
    def first_samples(self) -> FirstSamples:
        """The first samples of the parts."""
        return FirstSamples.of(self.parts, self.base.start_up)

    def penalty(self, coordinates: FloatArray) -> FloatArray:
        """Return what the coordinates cost by themselves, (2 d,), to be squared."""
        outside = np.maximum(np.maximum(coordinates - self.high, self.low - coordinates), 0.0)
        return self.size * np.concatenate([
            self.box_weight * outside, MIDDLE * (coordinates - self.middle)])

    @property
    def box_weight(self) -> float:
        """Weight of the search box."""
        return BOX * math.sqrt(sum(self.lengths))

    def penalty_jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the penalty by the coordinates, (2 d, d)."""
        beyond = np.sign(coordinates - np.clip(coordinates, self.low, self.high))
        jacobian: FloatArray = self.size * np.concatenate([
            np.diag(self.box_weight * beyond), MIDDLE * np.eye(len(coordinates))])
        return jacobian

    def candidate(self, coordinates: FloatArray) -> Model:
        """Set the coordinates of the unknowns."""
        values = [u.value(float(c)) for u, c in zip(self.unknowns, coordinates, strict=True)]
        return put(self.base, self.unknowns, values)

    def directions(self, candidate: Model) -> tuple[Directions, list[int]]:
        """Say how a run moves with the coordinates, and which of them each column is.

        Args:
            candidate: what is run.
        """
        stages = candidate.system.stages
        times = np.array([stage.time for stage in stages])
        plant, laws, shifts = [], [], []
        T, inputs = candidate.sample_time, candidate.plant.inputs
        for k, unknown in enumerate(self.unknowns):
            worth = get(candidate, unknown) if unknown.log else unknown.scale
            if unknown.owner == '':
                values = np.array([stage.values[unknown.name] for stage in stages])
                plant.append((k, (unknown.name, values / candidate.values[unknown.name] * worth)))
            elif unknown.owner == 'timing':
                shifts.append((k, [worth / T * (signal.name == unknown.name)
                                   for signal in inputs]))
            else:
                placed = candidate.effects[int(unknown.owner)]
                effect, begin = placed.effect, candidate.system.begins[int(unknown.owner)]
                if effect.course is not None:
                    name = placed.port.name
                    slope = effect.course.slopes(placed.values, times)[
                        list(placed.named).index(unknown.name)]
                    plant.append((k, (name, candidate.values[name] * slope * worth)))
                elif begin < 0:
                    shifts.append((k, [worth / T * (signal.held or effect.shifts == 'all')
                                       for signal in inputs]))
                else:
                    laws.append((k, (begin + list(placed.named).index(unknown.name), worth)))
        order = [k for some in (plant, laws, shifts) for k, _ in some]
        by = Directions([d for _, d in plant], [d for _, d in laws], [d for _, d in shifts])
        return by, order

    def at(self, coordinates: FloatArray, weights: FloatArray | None = None,
           scales: FloatArray | None = None, near: InitialStates | None = None) -> Evaluation:
        """Run over all parts with derivatives; a run that diverged has a large, finite residual.

        Args:
            coordinates: of the unknowns, (d,).
            weights: of the first samples of each part, if they are to be kept.
            scales: of output and sensors; None: by how much each moves.
            near: initial states at other coordinates, which may do here.
        """
        candidate = self.candidate(coordinates)
        system, response = candidate.system, linear_response(candidate)
        by, order = self.directions(candidate)
        tangents = tangents_of(system, by)
        scales = self.size / self.pieces.sizes if scales is None else scales

        def run_from(parts: IntArray, initial: InitialStates, weights: FloatArray | None
                     ) -> Eliminated:
            """Run over some parts, and eliminate their initial states."""
            layout = self.layout.at(parts)
            # Contiguous with sensors, too: for another layout all would be compiled again.
            feedback = FREE if self.gain is None else OutputFeedback(
                np.ascontiguousarray(layout.measured[:, 0]), self.gain)
            residual, rows = self.residual(layout, parts, *run_with_sensitivities(
                system, by, tangents, layout.inputs, layout.edges, initial.x, initial.z,
                [self.parts[k].start for k in parts], self.sensors, feedback), scales)
            return eliminate(residual, rows[:, by.count:], response, layout.of_parts,
                             rows[:, np.argsort(order)], weights, initial.margins)

        initial = initial_states(candidate, self.parts, near, self.first_samples)
        runs, initial = eliminate_with_reruns(run_from, initial, weights, in_search=True)
        return Evaluation(coordinates, runs.residual, runs.jacobian, runs.weights, scales,
                          self.penalty(coordinates), initial)

    def residual(self, layout: Layout, parts: IntArray, y: FloatArray, slopes: FloatArray,
                 scales: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual of runs over parts and the derivatives of the output.

        Scaled and filtered as they count in the fit, and bounded where a run diverged.

        Args:
            layout: of the parts.
            parts: which.
            y: output and sensors, (N, 1 + K).
            slopes: their derivatives, (N, 1 + K, D).
            scales: of output and sensors, (1 + K,).
        """
        most = DIVERGED * self.size
        residual = np.nan_to_num(layout.pick(layout.measured - y, scales), nan=most)
        residual, rows = np.clip(residual, -most, most), layout.pick(slopes, scales)
        for k, (begin, _, end) in zip(parts, layout.of_parts, strict=True):
            if filters := self.parts[k].filters:
                residual[begin:end], rows[begin:end] = (
                    self.stacks[k].whitened(one[begin:end], filters) for one in (residual, rows))
        return residual, rows

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the coordinates."""
        def edge(unknown: Unknown, value: float) -> float:
            if unknown.log and value <= 0.0:
                return -math.inf
            return unknown.coordinate(value) if math.isfinite(value) else value
        return (np.array([edge(u, u.lower) for u in self.unknowns]),
                np.array([edge(u, u.upper) for u in self.unknowns]))

    def evaluate_base(self) -> Evaluation:
        """Evaluate the base."""
        lower, upper = self.bounds()
        begin = coordinates_of(self.base, self.unknowns)
        # A hair within the bounds: at one there may be a kink, and its other side counts for
        # nothing, as where a command acts a whole sample early.
        hair = INSIDE * np.maximum(1.0, np.abs(begin))
        begin = np.clip(begin, lower + hair, upper - hair)
        here = self.at(begin)
        return self.at(begin, scales=self.likely_scales(here)) if self.sensors else here

    def unsearched(self) -> Fit:
        """Take the base without a search."""
        return self.fit(self.evaluate_base())

    def linear_prediction(self) -> tuple[Evaluation, float]:
        """Evaluate the base, and predict the sum of squares after the first step of a search.

        That of linear least squares within the bounds (Gauss-Newton), no coordinate moving by
        more than `LONGEST_STEP`.
        """
        here = self.evaluate_base()
        lower, upper = self.bounds()
        factor = self.factor(here)
        step = lsq_linear(factor[:, :-1], -factor[:, -1],
                          (np.maximum(lower - here.coordinates, -LONGEST_STEP),
                           np.minimum(upper - here.coordinates, LONGEST_STEP)), method='bvls')
        return here, 2.0 * float(step.cost)

    def factor(self, here: Evaluation) -> FloatArray:
        """Return the triangular factor of the derivatives of what is squared, which comes last.

        All that a step needs to know of residual and penalty, whatever the number of samples,
        (d + 1, d + 1).
        """
        # The output rises by the Jacobian, so the residual falls.
        return triangle([np.vstack([
            np.column_stack([-here.jacobian, here.residual]),
            np.column_stack([self.penalty_jacobian(here.coordinates), here.penalty])])])

    def solve(self, evaluations: int = 40, tolerance: float = 1e-6) -> Fit:
        """Search from the base, within the bounds."""
        return self.fit(self.search(evaluations, tolerance))

    def search(self, evaluations: int, tolerance: float) -> Evaluation:
        """Search by a trust region, as scipy does [Branch, Coleman and Li 1999].

        The weights of the first samples, see `eliminate`, and the scales of output and sensors
        are kept during a search: the Jacobian does not hold their derivatives. Where they differ
        at the end, the search goes on with the new ones.

        Args:
            evaluations: most runs over the parts.
            tolerance: relative reduction of the sum of squares that ends it.
        """
        found = self.weighted_search(self.evaluate_base(), evaluations, tolerance)
        for _ in range(RESCALED if self.sensors else REWEIGHTED):
            if found.reason != CONVERGED:
                break
            now = self.at(found.coordinates, scales=self.likely_scales(found))
            if (np.abs(np.log(now.weights / found.weights)).max() < math.log(SAME_WEIGHT)
                    and np.abs(np.log(now.scales / found.scales)).max() < SAME_SCALE):
                break
            found = self.weighted_search(now, evaluations, tolerance)
        return found

    def weighted_search(self, here: Evaluation, evaluations: int, tolerance: float) -> Evaluation:
        """Search with the weights and scales that there are, see `search`.

        At a kink, where the derivatives promise what no step keeps, the trust region would shrink
        by a quarter at a time down to nothing. So a search also ends if `PATIENCE` evaluations in
        a row have not lowered the sum of squares.
        """
        weights, scales, (lower, upper) = here.weights, here.scales, self.bounds()
        best, stalled, last = here, 0, self.factor(here)

        def factor(coordinates: FloatArray) -> FloatArray:
            """Run, unless the derivatives are asked where the residual was."""
            nonlocal here, best, stalled, last
            if not np.array_equal(coordinates, here.coordinates):
                if stalled == PATIENCE:
                    raise _StalledError
                here = self.at(coordinates, weights, scales, best.initial)
                improved = here.sum_of_squares < (1.0 - tolerance) * best.sum_of_squares
                stalled = 0 if improved else stalled + 1
                best = min(here, best, key=lambda evaluation: evaluation.sum_of_squares)
                last = self.factor(here)
            return last

        def residual(coordinates: FloatArray) -> FloatArray:
            return factor(coordinates)[:, -1]

        def jacobian(coordinates: FloatArray) -> FloatArray:
            return factor(coordinates)[:, :-1]

        try:
            # Where the trust region has shrunk to next to nothing, scipy's step overflows.
            with np.errstate(over='ignore'):
                found = least_squares(
                    residual, here.coordinates, jac=jacobian, bounds=(lower, upper), method='trf',
                    x_scale=1.0, max_nfev=evaluations, ftol=tolerance, xtol=1e-8, gtol=1e-12)
        except _StalledError:
            return replace(best, reason=CONVERGED)
        return replace(best, reason=CONVERGED if found.status > 0 else 'evaluations')

    def fit(self, found: Evaluation) -> Fit:
        """Take what a search has found, with the scales that its residual asks for."""
        fit = Fit(self.candidate(found.coordinates), self.unknowns, found.residual, found.jacobian,
                  self.lengths, float(found.penalty @ found.penalty))
        if not self.sensors:
            return fit
        scales = self.likely_scales(found)
        rows = np.repeat((scales / found.scales)[list(self.pieces.outputs)], self.lengths)
        return replace(fit, residual=rows * fit.residual, jacobian=rows[:, None] * fit.jacobian,
                       outputs=self.pieces.outputs, sensors=self.sensors, scales=scales)

    def likely_scales(self, found: Evaluation) -> FloatArray:
        """Return the scales of output and sensors of the greatest likelihood, (1 + K,)."""
        return self.pieces.likely_scales(found.residual, found.scales)


def solve_all(problems: Sequence[Problem], evaluations: int = 40, tolerance: float = 1e-6
              ) -> Iterator[Fit]:
    """Search each of several problems, on all cores, and yield the fits in their order."""
    searches = in_processes(
        partial(Problem.search, evaluations=evaluations, tolerance=tolerance), problems)
    for problem, found in zip(problems, searches, strict=True):
        yield problem.fit(found)
