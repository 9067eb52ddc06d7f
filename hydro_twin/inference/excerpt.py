"""An excerpt of a long recording that is enough to fit a model and to distinguish effects.

It consists of stretches, because a long free run of a plant that integrates accumulates the model
error until that dominates, and has many local minima. They are downsampled where the free run
hardly changes by it. Neither choice depends on how well a model with effects fits, so that it
cannot favour one.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import horizon_windows, windows
from hydro_twin.fitting.output_error import initial_states
from hydro_twin.fitting.parts import least_samples, Part, thin
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.scores import rms

MAX_SAMPLES = 8_000     # scored samples
STRETCH_SAMPLES = 1_500    # samples of a stretch, with those that only set the state
FILLED = 0.8            # most that stretches cover, so that they need not keep step with a motion
COARSEST = 8            # factor that leaves enough of a stretch to be scored
HARMLESS = 0.01         # change of the output by thinning, as a share of the residual


def excerpt(parts: Sequence[Part], plant: Plant, sample_time: float, factor: int = 1
            ) -> list[Part]:
    """Cut stretches out of parts that hold more samples than it takes.

    They are spread evenly, each at a place by chance in its share of the part: a motion that
    repeats must not begin at the same point in all of them. Parts that are too short to be scored
    once they are thinned are left out.

    Args:
        parts: what was recorded.
        plant: what it was recorded of.
        sample_time: of the parts [s].
        factor: by which the stretches are going to be thinned, so that there may be more of them.
    """
    start_up = plant.start_samples(sample_time)
    least = least_samples(plant, factor * sample_time) * factor
    parts = [part for part in parts if len(part.measured) >= least]
    stretch = max(least, round(min(STRETCH_SAMPLES, plant.horizon / sample_time)))
    scored_at_all = sum(len(part.measured) - start_up for part in parts)
    if scored_at_all <= factor * MAX_SAMPLES:
        if not plant.integrates:
            return parts
        if scored_at_all <= MAX_SAMPLES:
            return horizon_windows(parts, plant, sample_time)
        return windows(parts, stretch, least, sample_time)
    enough = factor * MAX_SAMPLES
    scored = stretch - factor * plant.start_samples(factor * sample_time)
    total = sum(len(part.measured) for part in parts)
    rng = np.random.default_rng(0)
    cut = []
    for part in parts:
        n = len(part.measured)
        count = max(1, min(round(enough / scored * n / total), int(FILLED * n / stretch)))
        length = min(stretch, n)
        for k in range(count):
            begin = int(n * k / count + rng.uniform() * (n / count - length))
            cut.append(part.cut(begin, begin + length, sample_time))
    return cut[::max(1, len(cut) * scored // (2 * enough))]


def resampled(candidate: Model, sample_time: float) -> Model:
    """Let a candidate run with another sample time [s], with no more steps in a sample."""
    moved = candidate.at(sample_time)
    return replace(moved, substeps=min(moved.substeps, candidate.substeps))


def decimation_factor(fit: Fit, parts: Sequence[Part], recorded: int) -> int:
    """Find the power of two by which a long recording may be thinned.

    Until no more samples are left than needed, or as long as the free run hardly changes.

    Args:
        fit: the linear fit to the parts.
        parts: an excerpt.
        recorded: samples in the whole recording.
    """
    factor, candidate = 1, fit.candidate
    while factor < COARSEST and factor * MAX_SAMPLES < recorded:
        coarse = resampled(candidate, 2 * factor * candidate.sample_time)
        changes = []
        states = initial_states(candidate, parts).x
        for part, x, thinned in zip(
                parts, states, thin(parts, candidate.plant, 2 * factor), strict=True):
            there = coarse.system.run(thinned.inputs, x)
            changes.append(candidate.system.run(part.inputs, x)[::2 * factor][:len(there)]
                           - there)
        if not rms(np.concatenate(changes)) < HARMLESS * fit.error:
            break
        factor *= 2
    return factor
