"""A plant with effects and values for everything, discretised: what the kernel runs."""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import groupby, pairwise
import math
from typing import Any

import numpy as np
from scipy.linalg import expm

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.effects import Placed
from hydro_twin.effects.dispatch import code
from hydro_twin.plants.plant import Laws, Plant
from hydro_twin.predictors import kernel
from hydro_twin.predictors.kernel import ENTRY, Step

HOLD, LINEAR = 'hold', 'linear'     # how commands go from sample to sample
NEWTON = 20             # steps to the state at rest, at most
BEYOND = 1e30           # any edge
STAGES = 64             # of a drift, at most; half of one is the largest error
STAGE = 0.01            # change of a parameter in a stage, over its last value, where fewer do
TIMES = 4096            # at which a course is evaluated: to place 64 stages in a jump, too


@dataclass(frozen=True)
class System:
    """A step with what it was made of.

    Attributes:
        laws: the linear laws that it comes from.
        step: what the kernel takes.
        memory: how many numbers z holds: the memory of all effects, then one number for each, what
            it added last, if it is implicit.
        placed: the effects in the order of the step.
        begins: of each effect in the order given, where its parameters begin; -1: it has no law.
        values: parameters and constants by name.
        time: stamp [s] of these values, where a parameter drifts.
        earlier: where a parameter drifts, the systems that held until a stamp [ns], in order.
    """

    plant: Plant
    laws: Laws
    step: Step
    memory: int
    placed: tuple[Placed, ...]
    begins: tuple[int, ...]
    values: Mapping[str, float]
    time: float = math.inf
    earlier: tuple[tuple[int, System], ...] = ()

    @cached_property
    def live(self) -> tuple[Any, ...]:
        """The fields of the step, as `kernel.live_step` takes them."""
        return kernel.live_fields(self.step)

    @property
    def stages(self) -> tuple[System, ...]:
        """Return the systems that held one after another, each by itself; this one is the last."""
        last = replace(self, earlier=()) if self.earlier else self
        return (*(system for _, system in self.earlier), last)

    def at(self, stamp: int | None) -> System:
        """Return the system that holds at a stamp [ns]; None stands for now."""
        stage = self.stage_at(stamp)
        return self.earlier[stage][1] if stage < len(self.earlier) else self

    def stage_at(self, stamp: int | None) -> int:
        """Return the index of the stage that holds at a stamp [ns]; None stands for now."""
        if stamp is not None:
            for k, (until, _) in enumerate(self.earlier):
                if stamp < until:
                    return k
        return len(self.earlier)

    def stretches(self, samples: int, start: int | None) -> Iterator[tuple[int, int, int]]:
        """Divide a run among the stages that hold in it.

        Args:
            samples: in the run.
            start: stamp of the first [ns]; None stands for now.

        Yields:
            Index of the stage, its first sample, and the one after its last.
        """
        first = 0
        if start is not None and self.earlier:
            period = round(self.step.sample_time * 1e9)
            for k, (until, _) in enumerate(self.earlier):
                last = min(-((start - until) // period), samples)
                if last > first:
                    yield k, first, last
                    first = last
        if first < samples:
            yield len(self.earlier), first, samples

    def work(self) -> FloatArray:
        """Allocate the scratch of a step: eight rows, as long as one of M and as the memory."""
        return np.zeros((8, max(self.step.M.shape[1], self.memory)))

    def start(self, inputs: FloatArray, output: float) -> FloatArray:
        """Return the state at rest, shape (n,), that gives this output under these inputs (m,).

        An output that was not measured counts as zero.
        """
        known = output if math.isfinite(output) else 0.0
        x: FloatArray = self.at_rest(inputs[None, :], np.array([known]))[0]
        return x

    def at_rest(self, inputs: FloatArray, outputs: FloatArray) -> FloatArray:
        """Return the states at rest that give K outputs under as many inputs (K, m), (K, n).

        What effects add to the output, as a bias of the sensor or a coupling that stiffens does,
        is allowed for, by Newton's method.
        """
        rest = [self.plant.states.index(name) for name in self.plant.at_rest]
        rows = np.vstack([self.laws.A[rest], self.laws.C])
        right = -inputs @ np.concatenate([self.laws.B[rest], self.laws.D]).T
        found = np.linalg.solve(rows, np.vstack([right, np.eye(len(rows))[-1]]).T).T
        origin, per_output = found[:-1], found[-1]
        linear = outputs.copy()             # the output by the linear laws only
        left = np.arange(len(outputs) if len(self.step.active) else 0)
        for _ in range(NEWTON):
            if not len(left):
                break
            at, wanted = linear[left], outputs[left]
            step = 1e-6 * np.maximum(np.maximum(abs(at), abs(wanted)), 1e-9)
            y, beyond = (self._outputs(inputs[left], origin[left] + value[:, None] * per_output)
                         for value in (at, at + step))
            apart = abs(y - wanted) > 1e-9 * abs(wanted)
            linear[left] = np.where(
                apart, at - (y - wanted) / np.maximum((beyond - y) / step, 1.0), at)
            left = left[apart]
        x: FloatArray = origin + linear[:, None] * per_output
        return x

    def _outputs(self, inputs: FloatArray, x: FloatArray) -> FloatArray:
        """Return the outputs in K states (K, n), where the effects keep nothing, (K,)."""
        y = np.empty(len(x))
        kernel.output_each(self.step, x, np.zeros((len(x), self.memory)), self.work(), inputs, y)
        return y

    def commanded(self, largest: FloatArray) -> FloatArray:
        """Return how far commands can move the states that only they move, (n,).

        By the linear laws; infinity for the others, and where there is no command.

        Args:
            largest: magnitude of each input, (m,).
        """
        moved = [self.plant.states.index(name) for name in self.plant.commanded]
        found: FloatArray = np.full(len(self.laws.A), np.inf)
        A, B = self.laws.A[np.ix_(moved, moved)], self.laws.B[moved]
        far = abs(np.linalg.solve(A, B)) @ largest
        found[moved] = np.where(far > 0.0, far, np.inf)
        return found

    def free_response(self, samples: int) -> FloatArray:
        """Response of the output to each initial state by the linear laws, (samples, n)."""
        n = len(self.laws.A)
        response = np.empty((samples, n))
        response[:1] = self.laws.C[:1]
        kernel.respond(np.linalg.matrix_power(self.step.M[:, :n], self.step.substeps), response)
        return response

    def run(self, inputs: FloatArray, x: FloatArray, z: FloatArray | None = None,
            seen: FloatArray | None = None, start: int | None = None) -> FloatArray:
        """Run freely from state x over inputs (N, m); returns the output (N,).

        Args:
            inputs: (N, m).
            x: the state, (n,).
            z: what the effects keep, (memory,); by default zeros.
            seen: what passes at the ports and what the sensors read is written here, if given,
                (N, ports + signals + sensors).
            start: stamp of the first sample [ns], which matters where a parameter drifts; None
                stands for now.
        """
        x, z = x.copy(), np.zeros(self.memory) if z is None else z.copy()
        y, stages = np.empty(len(inputs)), self.stages
        for k, first, last in self.stretches(len(inputs), start):
            kernel.run(stages[k].step, x, z, self.work(), inputs, y,
                       np.empty((0, 0)) if seen is None else seen, first, last)
            if math.isnan(y[last - 1]):
                break
        return y

    def sensor_rows(self, names: Sequence[str]) -> IntArray:
        """Index the rows of H of sensors, (K,)."""
        known = [sensor.name for sensor in self.plant.sensors]
        return np.array([self.step.sensors + known.index(name) for name in names], dtype=np.int64)

    def run_parts(self, inputs: FloatArray, edges: IntArray, x: FloatArray,
                  z: FloatArray | None = None, starts: Sequence[int | None] = ()) -> FloatArray:
        """Run freely over P parts that follow one another, each from its own state.

        Args:
            inputs: of all parts, (N, m).
            edges: where each part begins there, and where the last one ends, (P + 1,).
            x: the states, (P, n).
            z: what the effects keep, (P, memory); by default zeros.
            starts: stamp of the first sample of each [ns]; by default now.

        Returns:
            The outputs, (N,), nan from where a run diverges.
        """
        x = x.copy()
        z = np.zeros((len(x), self.memory)) if z is None else z.copy()
        y, stages, work = np.empty(len(inputs)), self.stages, self.work()
        for k, stretches in self.stretches_of(edges, starts):
            kernel.run_stretches(stages[k].step, x, z, work, inputs, y, np.empty((0, 0)),
                                 stretches)
        return y

    def stretches_of(self, edges: IntArray, starts: Sequence[int | None] = ()
                     ) -> Iterator[tuple[int, IntArray]]:
        """Divide runs over parts that follow one another among the stages that hold in them.

        Yields:
            Index of a stage, and some stretches of it: of each its part, where that begins and
            ends, and its first sample there and the one after its last, (R, 5).
        """
        every = [(k, part, begin, end, first, last)
                 for part, ((begin, end), start) in enumerate(zip(
                     pairwise(edges.tolist()), starts or [None] * (len(edges) - 1), strict=True))
                 for k, first, last in self.stretches(end - begin, start)]
        for k, some in groupby(every, key=lambda one: one[0]):
            yield k, np.array([one[1:] for one in some])

    def memory_edges(self, inputs: FloatArray, x: FloatArray) -> FloatArray:
        """Return the bounds of the effects' memory at the start of K runs, (K, memory, 2).

        The follower of a play may be anywhere between two edges, to which its law clips anything
        beyond. A load that swings may be anywhere: `BEYOND`, both ways. The memory of an implicit
        effect decays at once: zero.

        Args:
            inputs: of the first sample of each run, (K, m).
            x: its state, (K, n).
        """
        edges, plays = np.zeros((len(x), self.memory, 2)), []
        for placed, effect in zip(self.placed, self.step.effects, strict=True):
            begin = effect['z_begin']
            edges[:, begin:begin + placed.swings] = -BEYOND, BEYOND
            if not (placed.effect.swings or effect['implicit']) and effect['z_end'] > begin:
                plays.append(begin)
        if plays:
            for side, beyond in enumerate((-BEYOND, BEYOND)):
                z = np.zeros((len(x), self.memory))
                z[:, plays] = beyond
                kernel.output_each(self.step, x, z, self.work(), inputs, np.empty(len(x)))
                edges[:, plays, side] = z[:, plays]
        return edges


def discretise(laws: Laws, h: float) -> FloatArray:
    """Integrate x' = A x + V v exactly over a step in which v = [u, d] moves in a straight line.

    Returns:
        [Phi | inputs at start | at end | d at start | d at end], shape (..., n, n + 2m + 2P), with
        in front what the laws have in front.
    """
    *several, n, m = laws.B.shape
    block = np.zeros((*several, 3 * n, 3 * n), dtype=laws.A.dtype)
    block[..., :n, :n] = laws.A * h
    block[..., :n, n:2 * n] = block[..., n:2 * n, 2 * n:] = np.eye(n)
    exponential = expm(block)
    Phi, whole, late = (exponential[..., :n, k * n:(k + 1) * n] for k in range(3))
    V = np.concatenate([laws.B, laws.E], axis=-1) * h
    end, begin = late @ V, (whole - late) @ V
    return np.ascontiguousarray(np.concatenate(
        [Phi, begin[..., :m], end[..., :m], begin[..., m:], end[..., m:]], axis=-1))


def assemble(plant: Plant, values: Mapping[str, float], effects: Sequence[Placed] = (),
             sample_time: float | None = None, substeps: int = 4,
             timing: Mapping[str, float] | None = None, interpolation: str = HOLD) -> System:
    """Make a system of a plant.

    Args:
        plant: the plant.
        values: parameters and constants by name; of a parameter that drifts, the last one.
        effects: on its ports.
        sample_time: [s]; the plant's own by default.
        substeps: steps in a sample. One is exact, and taken, where there are no effects and inputs
            act at the samples.
        timing: how late inputs act [s], by name, besides what a delay among the effects adds.
        interpolation: of commands between samples, `HOLD` or `LINEAR`.
    """
    T = sample_time or plant.sample_time
    now = _assemble(plant, values, effects, T, substeps, timing or {}, interpolation)
    courses = [(course, placed.values) for placed in effects
               if (course := placed.effect.course) is not None]
    if not courses:
        return now
    begins, ends = zip(*(course.interval(drift) for course, drift in courses), strict=True)
    time = np.linspace(min(begins), max(ends), TIMES + 1)
    # A jump gets as many stages as a slow drift; and a parameter that does not move yet, one.
    change = STAGE * np.linspace(0.0, 1.0, TIMES + 1)
    for course, drift in courses:
        change[1:] += np.cumsum(np.abs(np.diff(course.factor(drift, time))))
    # A power of two, so that the number seldom changes while a rate is searched.
    stages = min(STAGES, 2 ** math.ceil(math.log2(change[-1] / STAGE)))
    edges = np.interp(np.linspace(0.0, change[-1], stages + 1), change, time)
    before = 2.0 * edges[0] - edges[1]
    then = _at_times(now, np.append(before, 0.5 * (edges[:-1] + edges[1:])), effects)
    return replace(now, earlier=tuple(
        (round(1e9 * end), system) for end, system in zip(edges.tolist(), then, strict=True)))


def _at_times(now: System, times: FloatArray, effects: Sequence[Placed]) -> Iterator[System]:
    """Yield a system as it was at some times [s].

    Args:
        now: the system as it is.
        times: in question.
        effects: of which some are parameters that drift.
    """
    drifting: dict[str, FloatArray] = {}
    for placed in effects:
        if placed.effect.course is not None:
            name = placed.port.name
            drifting[name] = (drifting.get(name, now.values[name])
                              * placed.effect.course.factor(placed.values, times))
    several: Mapping[str, Any] = {
        **now.values, **{name: values[:, None] for name, values in drifting.items()}}
    laws = now.plant.laws(several)
    M, H = discretise(laws, now.step.sample_time / now.step.substeps), port_rows(laws)
    for k, time in enumerate(times.tolist()):
        then = {name: float(values[k]) for name, values in drifting.items()}
        yield replace(now, laws=laws.of(k), step=now.step._replace(M=M[k], H=H[k]),
                      values={**now.values, **then}, time=time)


def _assemble(plant: Plant, values: Mapping[str, float], effects: Sequence[Placed], T: float,
              substeps: int, timing: Mapping[str, float], interpolation: str) -> System:
    """Make a system of parameters that do not change."""
    late = np.array([timing.get(signal.name, 0.0) for signal in plant.inputs]) / T
    command = np.array([signal.held for signal in plant.inputs])
    at_port = sorted((placed for placed in effects if placed.effect.law is not None),
                     key=lambda placed: plant.ports.index(placed.port))
    for placed in effects:
        if placed.effect.shifts:
            late = late + np.where(command | (placed.effect.shifts == 'all'),
                                   placed.values[0] / T, 0.0)
    entries: list[tuple[int, ...]] = []
    p: list[float] = []
    memory = 0
    for placed in at_port:
        signals = [plant.signal_row(placed.port, name) for name in placed.effect.reads]
        signals = [*signals, -1, -1][:2]
        kept = placed.effect.memory
        entries.append((code(placed.effect), plant.ports.index(placed.port), *signals,
                        len(p), len(p) + len(placed.values), memory, memory + kept,
                        placed.effect.implicit))
        p.extend(placed.values)
        memory += kept
    # An input that changes within a sample is averaged over a step, or interpolated across it.
    steps = substeps if entries or (late % 1.0).any() else 1
    active = sorted({plant.ports.index(placed.port) for placed in at_port
                     if not placed.effect.implicit})
    laws, M, H = _linear_step(plant, tuple(values.items()), T / steps)
    step = Step(
        M=M, H=H,
        effects=np.array(entries, dtype=ENTRY), active=np.array(active, dtype=np.int64),
        p=np.array(p, dtype=np.float64), shift=late, held=command & (interpolation == HOLD),
        substeps=steps, sample_time=T, sensors=len(laws.port_x) + len(laws.signal_x))
    begin = {id(placed): entry[4] for placed, entry in zip(at_port, entries, strict=True)}
    return System(plant=plant, laws=laws, step=step, memory=memory + len(entries),
                  placed=tuple(at_port),
                  begins=tuple(begin.get(id(placed), -1) for placed in effects),
                  values=values)


@lru_cache(maxsize=8)   # most candidates of a trace share their parameters
def _linear_step(plant: Plant, values: tuple[tuple[str, float], ...], h: float
                 ) -> tuple[Laws, FloatArray, FloatArray]:
    """Return the linear laws of a plant, and M and H of a step of h [s], see `Step`."""
    laws = plant.laws(dict(values))
    return laws, discretise(laws, h), port_rows(laws)


def port_rows(laws: Laws) -> FloatArray:
    """Stack the rows of ports' values, of signals and of sensors, (..., P + S + R, n + m + P)."""
    return np.ascontiguousarray(np.concatenate([
        np.concatenate(rows, axis=-1) for rows in (
            [laws.port_x, laws.port_u, laws.port_d], [laws.signal_x, laws.signal_u, laws.signal_d],
            [laws.sensor_x, laws.sensor_u, laws.sensor_d])], axis=-2))
