"""How far predictions are from what was measured."""
from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from hydro_twin.plants.plant import FloatArray
from hydro_twin.recording.series import Recording


def rms(error: FloatArray) -> float:
    """Root of the mean square, [B19] eq. 5; nan of nothing."""
    return float(np.sqrt(np.mean(np.square(error)))) if len(error) else math.nan


def fit_percent(error: FloatArray, measured: FloatArray) -> float:
    """100 (1 - |error| / |measured - its mean|): 100 is perfect, 0 no better than the mean."""
    spread = float(np.linalg.norm(measured - measured.mean()))
    return 100.0 * (1.0 - float(np.linalg.norm(error)) / spread) if spread else math.nan


def pooled(recording: Recording, output: str, predictions: Sequence[FloatArray], skip: int
           ) -> tuple[FloatArray, FloatArray]:
    """Join the errors of all series, without the first `skip` samples of each.

    Returns:
        (measured - predicted, measured), each of shape (N,).
    """
    measured = np.concatenate([series[output][skip:] for series in recording.series])
    predicted = np.concatenate([prediction[skip:] for prediction in predictions])
    return measured - predicted, measured


def persistence(recording: Recording, output: str) -> float:
    """RMS error of repeating the last sample: what any prediction one step ahead must beat."""
    return rms(np.concatenate([np.diff(s[output]) for s in recording.series]))
