"""What a sensor makes of an output: noise, and steps."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_twin.recording.series import Series


def measure(series: Series, signal: str, snr: float | None, noise: float, quantisation: float,
            rng: np.random.Generator) -> tuple[Series, float]:
    """Measure a signal with white Gaussian noise, rounded to whole steps.

    Args:
        series: as it truly was.
        signal: what is measured.
        snr: power of the signal about its mean over that of the noise [dB]; None: use `noise`.
        noise: RMS, in the signal's unit.
        quantisation: step, in the signal's unit; 0 for none.
        rng: the source of chance.

    Returns:
        The series as measured, and the RMS of the noise.
    """
    y = series[signal]
    rms = noise if snr is None else float(np.std(y) * 10 ** (-snr / 20))
    measured = y + rms * rng.standard_normal(len(y)) if rms else y
    if quantisation:
        measured = quantisation * np.round(measured / quantisation)
    return replace(series, columns={**series.columns, signal: measured}), rms
