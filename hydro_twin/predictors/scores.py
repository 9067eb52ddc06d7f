"""The errors that are reported: one definition of each, for every verb, report and model file.

One step: the predictor's `one_step`, without the first order + 1 samples of each part, which only
feed the regressors [B19]. Observer: the predictor's `observer`, on the same samples. Free run: the
predictor's `free_run`, without the start-up of each series. Horizon: see
`fitting.horizon`. Persistence: the last sample repeated,
on the samples that one step is scored on.

A part of a series is scored by index in the run over the whole series. So a part that begins in
motion has no start of its own, and the errors of the parts are those of the run that the node and
`replay` publish.
"""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import math
from typing import TYPE_CHECKING

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.plants.plant import Plant
from hydro_twin.predictors.predictor import modes_of
from hydro_twin.recording.series import Recording, Series

if TYPE_CHECKING:
    from hydro_twin.predictors.predictor import Predictor

Errors = dict[str, dict[str, float]]        # mode -> part -> RMS error, in the output's unit
FIGURES = ('free_run', 'horizon', 'one_step', 'observer')       # in the order of tables


def rms(error: FloatArray) -> float:
    """Root of the mean square, [B19] eq. 5; nan of nothing."""
    return float(np.sqrt(np.mean(np.square(error)))) if len(error) else math.nan


def fit_percent(error: FloatArray, measured: FloatArray) -> float:
    """100 (1 - |error| / |measured - its mean|): 100 is perfect, 0 no better than the mean."""
    if not len(error):
        return math.nan
    spread = float(np.linalg.norm(measured - measured.mean()))
    return 100.0 * (1.0 - float(np.linalg.norm(error)) / spread) if spread else math.nan


def unscored(plant: Plant, sample_time: float, mode: str) -> int:
    """Count the samples at the start of a series that are not scored.

    Args:
        plant: the plant.
        sample_time: of the series [s].
        mode: 'one_step', 'free_run' or 'observer'.
    """
    return plant.start_samples(sample_time) if mode == 'free_run' else plant.order + 1


def first_scored(series: Series, plant: Plant, mode: str) -> int:
    """Return the index of the first sample of a series, or a part of one, that is scored."""
    skipped = unscored(plant, series.sample_time, mode)
    return max(skipped - series.offset, 0) if mode == 'free_run' else skipped


def predict(predictor: Predictor, series: Sequence[Series], mode: str) -> list[FloatArray]:
    """Predict every sample of each series; of a part, by the run over the series it is cut from.

    Args:
        predictor: what is run.
        series: series, or parts of some.
        mode: 'one_step', 'free_run' or 'observer'.

    Returns:
        For each series an array of its length, in the output's unit; nan as `Predictor` says.
    """
    return [predicted[part.offset:part.offset + len(part)]
            for part, predicted in runs_over(getattr(predictor, mode), series)]


def runs_over[Found](run: Callable[[Series], Found], series: Iterable[Series]
                     ) -> Iterator[tuple[Series, Found]]:
    """Pair each series, or part of one, with the run over the series it is cut from.

    Each of these is run once.
    """
    runs: dict[int, Found] = {}
    for part in series:
        whole = part.whole or part
        if id(whole) not in runs:
            runs[id(whole)] = run(whole)
        yield part, runs[id(whole)]


def errors_by_series(predictor: Predictor, series: Sequence[Series], mode: str
                     ) -> list[FloatArray]:
    """Return measured less predicted, scored samples only, of each series."""
    output = predictor.plant.output.name
    return [(part[output] - predicted)[first_scored(part, predictor.plant, mode):]
            for part, predicted in zip(series, predict(predictor, series, mode), strict=True)]


def errors_of(predictor: Predictor, parts: Mapping[str, Recording]) -> Errors:
    """Score a model on named parts, as 'train' and 'test'; nan where a run diverges."""
    return {mode: errors_in(predictor, parts, mode) for mode in modes_of(predictor.model)}


def errors_in(predictor: Predictor, parts: Mapping[str, Recording], mode: str
              ) -> dict[str, float]:
    """Score a model on named parts in one mode; nan where a run diverges."""
    every = [series for part in parts.values() for series in part.series]
    left = iter(errors_by_series(predictor, every, mode))
    return {name: rms(np.concatenate([next(left) for _ in part.series]))
            for name, part in parts.items()}


def sensor_errors(run: Callable[[Series], Mapping[str, FloatArray]], plant: Plant,
                  recording: Recording) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Compare what sensors read with a free run, where they are there, without the start-up.

    Args:
        run: a series -> what each sensor would read.
        plant: the plant.
        recording: series, or parts of some.

    Returns:
        Of each sensor that is in the recording (measured - predicted, measured), each (N,).
    """
    names = {sensor.name for sensor in plant.sensors}
    found: dict[str, list[FloatArray]] = {}
    for part, read in runs_over(run, (s for s in recording.series if names & s.columns.keys())):
        first = first_scored(part, plant, 'free_run')
        for name in [sensor.name for sensor in plant.sensors if sensor.name in part.columns]:
            measured = part[name][first:]
            predicted = read[name][part.offset + first:part.offset + len(part)]
            there = np.isfinite(measured)
            found.setdefault(name, []).append(
                np.stack([measured - predicted, measured])[:, there])
    joined = {name: np.concatenate(pieces, axis=1) for name, pieces in found.items()}
    return {name: (both[0], both[1]) for name, both in joined.items() if both.size}


def pooled(recording: Recording, plant: Plant, predictions: Sequence[FloatArray], mode: str
           ) -> tuple[FloatArray, FloatArray]:
    """Join the errors of all series, scored samples only.

    Returns:
        (measured - predicted, measured), each of shape (N,).
    """
    output = plant.output.name
    scored = [slice(first_scored(series, plant, mode), None) for series in recording.series]
    measured = np.concatenate([series[output][there] for series, there in
                               zip(recording.series, scored, strict=True)])
    predicted = np.concatenate([prediction[there] for prediction, there in
                                zip(predictions, scored, strict=True)])
    return measured - predicted, measured


def persistence(recording: Recording, plant: Plant) -> float:
    """RMS error of repeating the last sample: what any prediction one step ahead must beat."""
    return rms(np.concatenate([
        np.diff(series[plant.output.name][first_scored(series, plant, 'one_step') - 1:])
        for series in recording.series]))
