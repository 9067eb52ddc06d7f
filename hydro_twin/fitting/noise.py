"""The noise that the observer takes as known: maximum likelihood of its innovations."""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
import math

import numpy as np
from scipy.optimize import minimize

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.parts import SCORED
from hydro_twin.model import Model, Noise
from hydro_twin.predictors import kernel
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.observer import Observer, process_root
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Series

MAX_SAMPLES = 3000      # samples: they determine a standard deviation to 1.3 %
SERIES = 8              # that they come from at most: as many show how the noise varies
# How much process noise moves the output over the start-up time, in measurement noises: less than
# the first hardly differs from none, more than the second from none on the measurement.
LEAST, MOST = 0.01, 1e4
# Ratios of process noise where the search looks for its start. Downhill from too little it leaps
# to far too much.
RATIOS = (LEAST, 0.1, 1.0, 10.0, 100.0)
STARTS = 3              # best points that a search with sensors starts from: the best may mislead
SPAN = 10.0             # of the noise about its guess, either way, in logarithms
# Of the likelihood, by which a step of the search must still gain [nat]. The first steps are badly
# scaled, and gain little: with a hundredth the search stopped there, ten nats from the optimum.
NAT = 1e-4
PARTS = 1e-4            # step of its differences, in logarithms
QUIETEST = 1e-9         # of a typical large output, or of the movement of a sensor: least noise
DEAF = 1e6              # movements of a sensor: with so much noise it moves no estimate
LOST = 1e6              # nats a sample where the observer diverges: worse than any


@dataclass(frozen=True)
class Likelihood:
    """The likelihood of all that was measured, each sample given what came before it.

    Its unknowns are logarithms: for each state of `reach` its process noise, and the noise of each
    sensor, as ratios to that of the output. At given ratios the size of all noise has a best value
    in closed form, at which the likelihood is taken (concentrated likelihood).

    Attributes:
        predictor: of the model.
        guess: of the noise of the output.
        parts: what was recorded.
        measured: of each part, the output and the sensors of the plant, (N, 1 + R).
        columns: of these, the sensors that are measured, (K,).
        reach: what unit noise on the rate of a state moves the output by, over the start-up.
        start: standard deviation of each state in the free run.
    """

    predictor: Analytical
    guess: float
    parts: Sequence[Series]
    measured: Sequence[FloatArray]
    columns: IntArray
    reach: Mapping[str, float]
    start: Mapping[str, float]

    def noise(self, unknowns: FloatArray, size: float = 1.0) -> Noise:
        """Return the noise of some ratios, (D,) without or (D + K,) with sensors.

        Args:
            unknowns: the ratios.
            size: of all noise, over the guess.
        """
        measurement, ratios = self.guess * size, np.exp(unknowns)
        sensors = self.predictor.plant.sensors
        return Noise(measurement, {name: float(measurement * ratio / self.reach[name])
                                   for name, ratio in zip(self.reach, ratios, strict=False)},
                     self.start, sensors={
                         sensors[column - 1].name: float(measurement * ratio) for column, ratio in
                         zip(self.columns, ratios[len(self.reach):], strict=False)})

    def innovations(self, noise: Noise) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Run the observer: innovations and variances of each part, (N - 1, 1 or 1 + R)."""
        observer = Observer(self.predictor.system, noise)
        observer.filter = observer.filter._replace(gate=math.inf)       # what is far off counts
        for part, every in zip(self.parts, self.measured, strict=True):
            taken = every if noise.sensors else every[:, :1]
            results, _ = observer.run(self.predictor.inputs(part), taken, start=part.start)
            yield (taken - results[:, ::2])[1:], results[1:, 1::2]

    def loss(self, unknowns: FloatArray) -> float:
        """Return minus the logarithm of the likelihood, over the samples, up to a constant."""
        return self.sized(unknowns)[0]

    def sized(self, unknowns: FloatArray) -> tuple[float, float]:
        """Return that, and the size of all noise over the guess that is best at given ratios."""
        logarithms, squares, count, samples = 0.0, 0.0, 0, 0
        for innovation, variance in self.innovations(self.noise(unknowns)):
            if math.isnan(variance[-1, 0]):
                return LOST, 1.0
            relative = innovation ** 2 / variance
            there = np.isfinite(relative)
            logarithms += float(np.log(variance[there]).sum())
            squares += float(relative[there].sum())
            count, samples = count + int(there.sum()), samples + len(variance)
        size = min(max(math.sqrt(squares / count), math.exp(-SPAN)), math.exp(SPAN))
        return 0.5 * (logarithms + count * 2.0 * math.log(size)
                      + squares / size ** 2) / samples, size

    def spreads(self, alone: FloatArray, sizes: FloatArray) -> FloatArray:
        """RMS innovation of each sensor in an observer that uses the output only, (K,)."""
        deaf = self.noise(np.r_[alone, np.log(DEAF * sizes / self.guess)])
        left = np.concatenate([innovation[:, self.columns]
                               for innovation, _ in self.innovations(deaf)])
        return np.maximum(np.sqrt(np.nanmean(left ** 2, axis=0)), QUIETEST * sizes)


def estimate_noise(model: Model, series: Sequence[Series]) -> Noise | None:
    """Estimate the noise of an analytical model: of the output, the sensors and the process.

    Process noise is white, on the rate of each state that a port drives.

    Args:
        model: as fitted.
        series: what it was fitted to.

    Returns:
        The noise; None where the model diverges.
    """
    predictor = Analytical(model)
    plant = model.plant
    parts = excerpts(series)
    runs = np.concatenate([states(predictor, part) for part in parts])
    if not (np.abs(runs) < kernel.LIMIT).all():
        return None
    # White noise of variance 1 has second differences of variance 6, a smooth output small ones.
    second = np.concatenate([np.diff(part[plant.output.name], 2) for part in parts])
    guess = max(rms(second) / math.sqrt(6.0), QUIETEST * plant.output_scale)
    start = dict(zip(plant.states, map(float, runs.std(axis=0)), strict=True))
    reach = reach_of_noise(model)
    measured = [part.stacked([signal.name for signal in (plant.output, *plant.sensors)])
                for part in parts]
    movement = [float(np.std(column[np.isfinite(column)])) if np.isfinite(column).sum() >= SCORED
                else 0.0 for column in np.concatenate(measured).T]
    columns = 1 + np.flatnonzero(movement[1:])
    likelihood = Likelihood(predictor, guess, parts, measured, columns, reach, start)

    bounds = [(math.log(LEAST), math.log(MOST))] * len(reach)
    points = [np.log([ratio] * len(reach)) for ratio in RATIOS]
    if len(columns):
        sizes = np.array(movement)[columns]
        bounds += zip(np.log(QUIETEST * sizes / guess), np.log(DEAF * sizes / guess), strict=True)
        # Several sensors tell the process noise of the states apart: it may be on any one. The
        # first ratio is none, which is among the points already.
        points += [np.log(np.where(np.arange(len(reach)) == k, ratio, LEAST))
                   for ratio, k in product(RATIOS[1:], range(len(reach)))]
        points = [np.r_[point, np.log(likelihood.spreads(point, sizes) / guess)]
                  for point in points]
    starts = sorted(points, key=likelihood.loss)[:STARTS if len(columns) else 1]
    found = min((minimize(
        likelihood.loss, begin, method='L-BFGS-B', bounds=bounds,
        options={'ftol': NAT / sum(map(len, parts)), 'eps': PARTS}) for begin in starts),
        key=lambda one: float(one.fun))
    if not found.fun < LOST:
        return None
    noise = likelihood.noise(found.x, likelihood.sized(found.x)[1])
    expected = np.concatenate([variance[min(model.start_up, len(variance) // 2):, 0]
                               for _, variance in likelihood.innovations(noise)])
    return replace(noise, innovation=math.sqrt(expected.mean()) if noise.sensors else None)


def reach_of_noise(model: Model) -> dict[str, float]:
    """Say how far unit noise on the rate of each state moves the output over the start-up time.

    Of the states that a port drives, by the linear laws.
    """
    laws, states = model.system.laws, model.plant.states
    horizon = model.plant.start_samples(model.sample_time) * model.sample_time
    return {name: float(np.linalg.norm(laws.C @ process_root(laws, horizon, unit)))
            for name, row, unit in zip(states, laws.E, np.eye(len(states)), strict=True)
            if row.any()}


def excerpts(series: Sequence[Series]) -> list[Series]:
    """Cut equally long pieces from the middle of series, `MAX_SAMPLES` samples of all together.

    Of as many of the longest as give the most samples; a single sample shows no innovation.
    """
    longest = sorted((one for one in series if len(one) > 1), key=len, reverse=True)[:SERIES]
    count = max(range(1, len(longest) + 1), key=lambda k: (
        round(sum(min(len(one), MAX_SAMPLES / k) for one in longest[:k])), k))
    length = MAX_SAMPLES // count
    return [one.part((len(one) - length) // 2, (len(one) + length) // 2) if len(one) > length
            else one.part(0, len(one)) for one in longest[:count]]


def states(predictor: Analytical, series: Series) -> FloatArray:
    """Run freely from rest; returns the states at every sample, (N, n)."""
    system, inputs = predictor.system, predictor.inputs(series)
    period = round(1e9 * series.sample_time)
    x, z, work = (system.at(series.start).start(inputs[0], series[predictor.plant.output.name][0]),
                  np.zeros(system.memory), system.work())
    seen = np.empty((len(inputs), len(x)))
    for k in range(len(inputs)):
        if k > 0:
            kernel.live_step(x, z, work, inputs, k, *system.at(series.start + k * period).live)
        seen[k] = x
    return seen
