"""Fit of a plant with effects to recordings, by the error of its free run."""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import repeat
import math

import numpy as np
from scipy.optimize import least_squares

from hydro_twin.effects import Placed
from hydro_twin.fitting.identifiability import assess, Identifiability
from hydro_twin.fitting.output_error import initial_states, residuals, usual_response
from hydro_twin.fitting.outputs import Pieces, sensors_in, Stack
from hydro_twin.fitting.parallel import in_processes
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.start import Eliminated, Start, without_start
from hydro_twin.fitting.unknowns import (
    coordinates_of,
    get,
    label,
    plant_unknowns,
    put,
    timing_unknowns,
    Unknown,
    usual,
)
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.scores import rms
from hydro_twin.predictors.sensitivities import run_all_with_slopes
from hydro_twin.predictors.system import System
from hydro_twin.predictors.tangents import Directions, tangents_of

WALL = 3e-3             # weight of the search box, see `Problem`
MIDDLE = 1e-4           # weight of its middle
INSIDE = 1e-9           # distance to a bound, relative
REWEIGHTED = 2          # further searches with new weights; they settle after one, or hardly
REBALANCED = 8          # and of sensors with new scales
SAME_SCALE = 0.02       # change of the logarithm of a scale that hardly moves the fit
SAME_WEIGHT = 2.0       # ratio of two weights that give nearly the same start
SMALL = 0.1             # of the residual: a start that takes off less hardly turns the slopes
SUBSTEPS = 2            # steps in a sample of a search, which the last fits refine
GIVEN = 4               # steps in a sample with given effects: no search refines them later
CONVERGED = 'converged'


@dataclass(frozen=True)
class Fit:
    """A candidate fitted to parts.

    Attributes:
        residual: of all parts, one after another, scored samples only. Where there are sensors,
            theirs follow in each part, all scaled to weigh by their noise, see `outputs`.
        jacobian: its derivative by the coordinates of the unknowns, with the sign of a rise of
            the output, shape (N, d).
        lengths: scored samples of each piece of it, those of the output or of a sensor in a part.
        pulled: what leaving the usual values costs, as a sum of squares.
        outputs: which output each piece is of: 0, or one more than the index of the sensor.
        sensors: names of those that were fitted.
        scales: by which the residual of output and sensors was multiplied, (1 + K,).
    """

    candidate: Model
    unknowns: tuple[Unknown, ...]
    residual: FloatArray
    jacobian: FloatArray
    lengths: tuple[int, ...]
    pulled: float
    outputs: tuple[int, ...] = ()
    sensors: tuple[str, ...] = ()
    scales: FloatArray = field(default_factory=lambda: np.ones(1))

    @property
    def main(self) -> Fit:
        """The same with the pieces of the output alone, in its unit."""
        if not self.sensors:
            return self
        own = np.array(self.outputs) == 0
        rows, scale = np.repeat(own, self.lengths), self.scales[0]
        return replace(
            self, residual=self.residual[rows] / scale, jacobian=self.jacobian[rows] / scale,
            lengths=tuple(np.array(self.lengths)[own].tolist()), pulled=self.pulled / scale**2,
            outputs=(), sensors=(), scales=np.ones(1))

    @property
    def noise(self) -> dict[str, float]:
        """RMS of what is left of output and sensors, each in its unit."""
        every = np.repeat(self.outputs or (0,) * len(self.lengths), self.lengths)
        names = (self.candidate.plant.output.name, *self.sensors)
        return {name: rms(self.residual[every == q]) / float(self.scales[q])
                for q, name in enumerate(names)}

    @property
    def cost(self) -> float:
        """Root mean square of the residual with what leaving the usual values costs."""
        return math.sqrt((float(self.residual @ self.residual) + self.pulled)
                         / max(len(self.residual), 1))

    @property
    def error(self) -> float:
        """RMS of the residual of the output, in its unit."""
        return rms(self.main.residual)

    def at_bound(self) -> list[str]:
        """Name the unknowns that stopped at an edge of their range."""
        names = []
        for unknown in self.unknowns:
            value = unknown.coordinate(get(self.candidate, unknown))
            edges = [unknown.coordinate(edge) for edge in (unknown.lower, unknown.upper)
                     if math.isfinite(edge) and (edge > 0 or not unknown.log)]
            if any(abs(value - edge) < 1e-4 * max(1.0, abs(edge)) for edge in edges):
                names.append(label(unknown))
        return names

    def identifiability(self) -> Identifiability:
        """Say what the data determine; see `identifiability`."""
        cuts = np.cumsum(self.lengths)[:-1]
        stretches = zip(np.split(self.jacobian, cuts), np.split(self.residual, cuts), strict=True)
        names = [label(unknown) for unknown in self.unknowns]
        inside = [c for c in self.candidate.plant.combinations if all(name in names for name in c)]
        return assess(stretches, names, inside, self.at_bound())


@dataclass(frozen=True)
class Evaluation:
    """A run over all parts at some values of the unknowns, as where a search ended.

    Attributes:
        coordinates: of the unknowns, (d,).
        residual: of all parts, scored samples only, as in a `Fit`, (N,).
        slopes: rise of the output by each coordinate, (N, d).
        weights: of the first samples of each part.
        scales: of output and sensors, (1 + K,).
        pulled: what leaving the usual values costs, to be squared, (2 d,).
        reason: of stopping.
    """

    coordinates: FloatArray
    residual: FloatArray
    slopes: FloatArray
    weights: tuple[float, ...]
    scales: FloatArray
    pulled: FloatArray
    reason: str = ''


class Problem:
    """The search for unknowns on parts, by the residual of the free run.

    Where the data do not determine a direction, or an effect that is lacking bends the fit, it
    would run off to values no rig has. So leaving the search box by a factor of e costs as much
    as an error of 0.3 % of the output all over, and a still weaker pull keeps to its middle (to
    the start, for effects).

    The states at the starts of the parts are unknowns, too, which are eliminated.
    """

    def __init__(self, base: Model, unknowns: Sequence[Unknown], parts: Sequence[Part]
                 ) -> None:
        self.base = base
        self.unknowns = tuple(unknowns)
        self.parts = parts
        self.sensors = sensors_in(parts, base.plant, base.start_up)
        self.stacks = [Stack.of(part, self.sensors, base.start_up) for part in parts]
        self.pieces = Pieces.of(self.stacks)
        self.size, self.lengths = float(self.pieces.sizes[0]), self.pieces.lengths
        box = usual(base.plant)
        edges = [box[u.name] if u.owner == '' else (-math.inf, math.inf) for u in self.unknowns]
        self.low, self.high = np.array(edges).T
        starts = coordinates_of(base, self.unknowns)
        self.middle = np.array([0.5 * (low + high) if math.isfinite(low) else start
                                for (low, high), start in zip(edges, starts, strict=True)])

    def pull(self, coordinates: FloatArray) -> FloatArray:
        """Return what the coordinates cost by themselves, (2 d,), to be squared."""
        outside = np.maximum(np.maximum(coordinates - self.high, self.low - coordinates), 0.0)
        return self.size * np.concatenate([
            self.wall * outside, MIDDLE * (coordinates - self.middle)])

    @property
    def wall(self) -> float:
        """Weight of the box."""
        return WALL * math.sqrt(sum(self.lengths))

    def pull_slopes(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivative of the pull by each coordinate, (2 d, d)."""
        beyond = np.sign(coordinates - np.clip(coordinates, self.low, self.high))
        slopes: FloatArray = self.size * np.concatenate([
            np.diag(self.wall * beyond), MIDDLE * np.eye(len(coordinates))])
        return slopes

    def candidate(self, coordinates: FloatArray) -> Model:
        """Set the coordinates of the unknowns."""
        values = [u.value(float(c)) for u, c in zip(self.unknowns, coordinates, strict=True)]
        return put(self.base, self.unknowns, values)

    def directions(self, candidate: Model, stage: System) -> tuple[Directions, list[int]]:
        """Say how a run moves with the coordinates, and which of them each column is.

        Args:
            candidate: what is run.
            stage: of its system, since what a parameter that drifts is worth changes.
        """
        plant, laws, shifts = [], [], []
        T, inputs = candidate.sample_time, candidate.plant.inputs
        for k, unknown in enumerate(self.unknowns):
            worth = get(candidate, unknown) if unknown.log else unknown.scale
            if unknown.owner == '':
                factor = stage.values[unknown.name] / candidate.values[unknown.name]
                plant.append((k, (unknown.name, factor * worth)))
            elif unknown.owner == 'timing':
                shifts.append((k, [worth / T * (signal.name == unknown.name)
                                   for signal in inputs]))
            else:
                placed = candidate.effects[int(unknown.owner)]
                effect, begin = placed.effect, candidate.system.begins[int(unknown.owner)]
                if effect.course is not None:
                    name = placed.port.name
                    slope = effect.course.slopes(placed.values, stage.time)[
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

    def at(self, coordinates: FloatArray, weights: Sequence[float | None] = (),
           scales: FloatArray | None = None) -> Evaluation:
        """Run over all parts, with derivatives; a run that diverged has a large, finite error.

        Args:
            coordinates: of the unknowns, (d,).
            weights: of the first samples of each part, if they are to be kept.
            scales: of output and sensors; None: by how much each moves.
        """
        candidate = self.candidate(coordinates)
        system, n = candidate.system, len(candidate.plant.states)
        by, order = self.directions(candidate, system)
        tangents = tangents_of(system, lambda stage: self.directions(candidate, stage)[0])
        usual, limit = usual_response(candidate), 1e3 * self.size
        scales = self.size / self.pieces.sizes if scales is None else scales

        def run_from(start: Start, part: Part, stack: Stack, weight: float | None) -> Eliminated:
            y, slopes = run_all_with_slopes(system, by, tangents, part.inputs, start.x, start.z,
                                            part.start, self.sensors)
            rows = stack.pick(slopes, scales)
            others = np.empty((len(rows), by.count))
            others[:, order] = rows[:, :by.count]
            missed = np.clip(np.nan_to_num(stack.pick(stack.measured - y, scales), nan=limit),
                             -limit, limit)
            return without_start(missed, rows[:, by.count:], usual, stack.first, others, weight)

        left = []
        for part, stack, start, weight in zip(
                self.parts, self.stacks, initial_states(candidate, self.parts),
                weights or repeat(None), strict=False):
            run = run_from(start, part, stack, weight)
            if run.taken > SMALL * rms(run.residual):
                # The derivatives belong to a run from where elimination moves the start.
                nearer = Start(start.x + run.change[:n], start.z + run.change[n:])
                moved = run_from(nearer, part, stack, run.weight)
                if np.isfinite(moved.slopes).all():
                    run = run._replace(slopes=moved.slopes)
            left.append(run)
        return Evaluation(
            coordinates, np.concatenate([run.residual for run in left]),
            np.concatenate([run.slopes for run in left]), tuple(run.weight for run in left),
            scales, self.pull(coordinates))

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the coordinates."""
        def edge(unknown: Unknown, value: float) -> float:
            if unknown.log and value <= 0.0:
                return -math.inf
            return unknown.coordinate(value) if math.isfinite(value) else value
        return (np.array([edge(u, u.lower) for u in self.unknowns]),
                np.array([edge(u, u.upper) for u in self.unknowns]))

    def as_it_is(self) -> Fit:
        """Take the base without a search."""
        return self.fit(self.at(coordinates_of(self.base, self.unknowns)))

    def solve(self, evaluations: int = 40, tolerance: float = 1e-6) -> Fit:
        """Search from the base, within the bounds."""
        return self.fit(self.search(evaluations, tolerance))

    def search(self, evaluations: int, tolerance: float) -> Evaluation:
        """Search by a trust region, as scipy does [Branch, Coleman and Li 1999].

        The weight of a part's first samples, see `without_start`, and the scales of output and
        sensors are kept during a search: their own derivatives are not in the slopes. Where they
        differ at the end, the search goes on with the new ones.

        Args:
            evaluations: most runs over the parts.
            tolerance: relative reduction of the sum of squares that ends it.
        """
        lower, upper = self.bounds()
        begin = coordinates_of(self.base, self.unknowns)
        # A hair within the bounds: at one there may be a kink, and its other side counts for
        # nothing, as where a command acts a whole sample early.
        hair = INSIDE * np.maximum(1.0, np.abs(begin))
        begin = np.clip(begin, lower + hair, upper - hair)
        here = self.at(begin)
        if self.sensors:
            here = self.at(begin, scales=self.balanced(here))
        found = self.weighted_search(here, evaluations, tolerance)
        for _ in range(REBALANCED if self.sensors else REWEIGHTED):
            if found.reason != CONVERGED:
                break
            now = self.at(found.coordinates, scales=self.balanced(found))
            if all(max(a, b) < SAME_WEIGHT * min(a, b)
                   for a, b in zip(found.weights, now.weights, strict=True)
                   ) and np.abs(np.log(now.scales / found.scales)).max() < SAME_SCALE:
                break
            found = self.weighted_search(now, evaluations, tolerance)
        return found

    def weighted_search(self, here: Evaluation, evaluations: int, tolerance: float) -> Evaluation:
        """Search with the weights and scales that there are, see `search`."""
        weights, scales, (lower, upper) = here.weights, here.scales, self.bounds()

        def last(coordinates: FloatArray) -> Evaluation:
            """Run, unless the derivatives are asked where the residual was."""
            nonlocal here
            if not np.array_equal(coordinates, here.coordinates):
                here = self.at(coordinates, weights, scales)
            return here

        def residual(coordinates: FloatArray) -> FloatArray:
            return np.concatenate([last(coordinates).residual, here.pulled])

        def jacobian(coordinates: FloatArray) -> FloatArray:
            return np.vstack([-last(coordinates).slopes, self.pull_slopes(coordinates)])

        found = least_squares(residual, here.coordinates, jac=jacobian, bounds=(lower, upper),
                              method='trf', x_scale=1.0, max_nfev=evaluations, ftol=tolerance,
                              xtol=1e-8, gtol=1e-12)
        return replace(last(found.x), reason=CONVERGED if found.status > 0 else 'evaluations')

    def fit(self, found: Evaluation) -> Fit:
        """Take what a search has found, with the scales that its residual asks for."""
        fit = Fit(self.candidate(found.coordinates), self.unknowns, found.residual, found.slopes,
                  self.lengths, float(found.pulled @ found.pulled))
        if not self.sensors:
            return fit
        scales = self.balanced(found)
        rows = np.repeat((scales / found.scales)[list(self.pieces.outputs)], self.lengths)
        return replace(fit, residual=rows * fit.residual, jacobian=rows[:, None] * fit.jacobian,
                       outputs=self.pieces.outputs, sensors=self.sensors, scales=scales)

    def balanced(self, found: Evaluation) -> FloatArray:
        """Return the scales of output and sensors that a residual asks for, (1 + K,)."""
        return self.pieces.balanced(found.residual, found.scales)


def solve_all(problems: Sequence[Problem], evaluations: int = 40, tolerance: float = 1e-6
              ) -> Iterator[Fit]:
    """Search each of several problems, on all cores, and yield the fits in their order."""
    searches = in_processes(
        partial(Problem.search, evaluations=evaluations, tolerance=tolerance), problems)
    for problem, found in zip(problems, searches, strict=True):
        yield problem.fit(found)


def fit_linear(plant: Plant, parts: Sequence[Part], constants: Mapping[str, float],
               sample_time: float, within: str, timing: bool, seed: int = 0,
               starts: int = 3, effects: tuple[Placed, ...] = ()) -> Fit:
    """Fit the parameters of the plant from several starts; the best fit is returned.

    The starts are the middle of the box and the best of random draws in it. A residual that
    effects have bent leads a single start astray.

    Args:
        plant: the plant.
        parts: what it is fitted to.
        constants: of the rig.
        sample_time: of the parts [s].
        within: 'box' or 'physical', see `plant_unknowns`.
        timing: whether commands may act up to a sample before their stamps say.
        seed: of the draws.
        starts: how many searches are made.
        effects: known ones, which stay as they are.
    """
    unknowns = plant_unknowns(plant, within)
    if timing:
        unknowns += timing_unknowns(plant, sample_time)
    rng = np.random.default_rng(seed)
    base = Model(plant, {**constants, **plant.middle()}, sample_time, effects,
                 substeps=GIVEN if effects else SUBSTEPS)
    draws = [base] + [
        replace(base, values={**base.values, **{
            p.name: float(math.exp(rng.uniform(math.log(p.lower), math.log(p.upper))))
            for p in plant.parameters}})
        for _ in range(24)]
    some = [min(parts, key=lambda part: len(part.measured))] if len(parts) > 6 else parts

    def error(candidate: Model) -> float:
        return rms(np.nan_to_num(np.concatenate(residuals(candidate, some)), nan=1e30))

    tried = [draws[0], *sorted(draws[1:], key=error)[:starts - 1]]
    fits = solve_all([Problem(candidate, unknowns, parts) for candidate in tried])
    return min(fits, key=lambda fit: fit.cost)
