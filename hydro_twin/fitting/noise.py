"""The noise that the observer takes as known: maximum likelihood of its innovations."""
from __future__ import annotations

from collections.abc import Sequence
from itertools import product
import math

import numpy as np
from scipy.optimize import minimize

from hydro_twin.model import Model, Noise
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors import kernel
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.observer import Observer, process_root
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Series

ENOUGH = 3000           # samples: they determine a standard deviation to 1.3 %
# How much process noise moves the output over the start-up time, in measurement noises: less than
# the first hardly differs from none, more than the second from none on the measurement.
LEAST, MOST = 0.01, 1e4
# Where the search looks for its start: measurement noises, in shares of that of second
# differences, and ratios of process noise. Downhill from too little it leaps to far too much.
SHARES, RATIOS = (0.1, 1.0), (0.1, 1.0, 10.0, 100.0)
SPAN = 10.0             # of the measurement noise, either way, in logarithms
NAT = 1e-2              # of the likelihood, by which a step of the search must still gain
PARTS = 1e-4            # step of its differences, in logarithms
QUIETEST = 1e-9         # of a typical large output: least noise that a search starts from
LOST = 1e6              # nats a sample where the observer diverges: worse than any


def estimate_noise(model: Model, series: Sequence[Series]) -> Noise | None:
    """Estimate the noise of an analytical model.

    Process noise is white, on the rate of each state that a port drives.

    Args:
        model: as fitted.
        series: what it was fitted to.

    Returns:
        The noise; None where the model diverges.
    """
    predictor = Analytical(model)
    system, plant = predictor.system, model.plant
    parts = excerpts(series)
    runs = np.concatenate([states(predictor, part) for part in parts])
    if not (np.abs(runs) < kernel.LIMIT).all():
        return None
    # White noise of variance 1 has second differences of variance 6, a smooth output small ones.
    second = np.concatenate([np.diff(part[plant.output.name], 2) for part in parts])
    guess = max(rms(second) / math.sqrt(6.0), QUIETEST * plant.output_scale)
    start = dict(zip(plant.states, map(float, runs.std(axis=0)), strict=True))
    horizon = plant.start_samples(model.sample_time) * model.sample_time
    reach = {}                          # what unit noise on a state moves the output by
    for name, row in zip(plant.states, system.laws.E, strict=True):
        if row.any():
            unit = np.array([float(other == name) for other in plant.states])
            reach[name] = float(np.linalg.norm(
                system.laws.C @ process_root(system.laws, horizon, unit)))

    def noise(logarithms: FloatArray) -> Noise:
        measurement = math.exp(logarithms[0])
        return Noise(measurement, {name: measurement * math.exp(ratio) / reach[name]
                                   for name, ratio in zip(reach, logarithms[1:], strict=True)},
                     start)

    def loss(logarithms: FloatArray) -> float:
        observer = Observer(system, noise(logarithms))
        total = np.zeros(2)
        for part in parts:
            measured = part[plant.output.name]
            results, _ = observer.run(predictor.inputs(part), measured, start=part.start)
            innovation, variance = (measured - results[:, 0])[1:], results[1:, 1]
            total += 0.5 * np.nansum(np.log(variance) + innovation ** 2 / variance), len(variance)
            if math.isnan(results[-1, 0]):
                return LOST
        return float(total[0] / total[1])

    samples = sum(map(len, parts))
    points = [np.log([guess * share, *[ratio] * len(reach)])
              for share, ratio in product(SHARES, RATIOS)]
    found = minimize(
        loss, min(points, key=loss), method='L-BFGS-B',
        bounds=[(math.log(guess) - SPAN, math.log(guess) + SPAN),
                *[(math.log(LEAST), math.log(MOST))] * len(reach)],
        options={'ftol': NAT / samples, 'eps': PARTS})
    return noise(found.x) if found.fun < LOST else None


def excerpts(series: Sequence[Series]) -> list[Series]:
    """Cut equally long pieces from the middle of series, `ENOUGH` samples of all together."""
    longest = sorted(series, key=len, reverse=True)[:8]
    length = ENOUGH // len(longest)
    return [one.part((len(one) - length) // 2, (len(one) + length) // 2) if len(one) > length
            else one.part(0, len(one)) for one in longest]


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
