"""Figures 8 to 11 of [L18] for a fit of ours, and the error of each sample by network."""
from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
from scipy.stats import probplot

from hydro_twin.recording.series import FloatArray
from hydro_twin.valve.published_method import PublishedFit

BAND = 0.03     # prediction error of [L18], of full opening


def draw_residual(fit: PublishedFit, folder: Path) -> list[Path]:
    """Draw what [L18] shows of a residual: Q-Q plot, correlation, error band, error per sample.

    Args:
        fit: what to show.
        folder: an existing folder; four PNG files are written there.

    Returns:
        The files.
    """
    drawings = {'residual_qq': _qq, 'correlation': _correlation, 'prediction_band': _band,
                'error_per_sample': _errors}
    paths = []
    for name, draw in drawings.items():
        figure = Figure(figsize=(7, 4.5), layout='constrained')
        draw(fit, figure)
        paths.append(folder / f'{name}.png')
        figure.savefig(paths[-1], dpi=120)
    return paths


def residual_figures(fit: PublishedFit) -> dict[str, float]:
    """Compute the two correlations of [L18] over the training samples.

    Returns:
        `qq`: of the residual's quantiles with the normal ones; `fit`: of prediction and opening.
    """
    residual = _residual(fit)
    _, (_, _, qq) = probplot(residual)
    predicted, opening = fit.predictions['5-1-1'][:fit.train], fit.opening[:fit.train]
    return {'qq': float(qq), 'fit': float(np.corrcoef(predicted, opening)[0, 1])}


def _residual(fit: PublishedFit) -> FloatArray:
    return (fit.opening - fit.predictions['5-1-1'])[:fit.train]


def _qq(fit: PublishedFit, figure: Figure) -> None:
    (normal, ordered), (slope, intercept, r) = probplot(_residual(fit))
    axes = figure.subplots()
    axes.plot(normal, ordered, '.', markersize=3)
    axes.plot(normal, slope * normal + intercept, label=f'R = {r:.4f}')
    axes.set(title='Q-Q plot of the training residual', xlabel='normal quantile',
             ylabel='residual [1]')
    axes.legend()


def _correlation(fit: PublishedFit, figure: Figure) -> None:
    axes = figure.subplots()
    r = residual_figures(fit)['fit']
    axes.plot(fit.opening[:fit.train], fit.predictions['5-1-1'][:fit.train], '.', markersize=3,
              label=f'R = {100 * r:.4f} %')
    axes.set(title='One-step prediction against opening', xlabel='opening [1]',
             ylabel='predicted [1]')
    axes.legend()


def _band(fit: PublishedFit, figure: Figure) -> None:
    axes = figure.subplots()
    time = fit.sample_time * np.arange(len(fit.opening))
    axes.fill_between(time, fit.opening - BAND, fit.opening + BAND, alpha=0.2,
                      label=f'opening ± {100 * BAND:.0f} %')
    axes.plot(time, fit.opening, label='opening, filtered')
    axes.plot(time, fit.free_run, '--', label='5-1-1, free run')
    axes.axvline(time[fit.train], color='0.5', linewidth=0.8)
    axes.set(title='Prediction and band; the test part is right of the line', xlabel='time [s]',
             ylabel='opening [1]')
    axes.set_ylim(fit.opening.min() - 2 * BAND, fit.opening.max() + 2 * BAND)
    axes.legend()


def _errors(fit: PublishedFit, figure: Figure) -> None:
    axes = figure.subplots()
    for name, run in fit.predictions.items():
        axes.semilogy(np.maximum(np.abs(run - fit.opening), 1e-12), label=name, linewidth=0.8)
    axes.axvline(fit.train, color='0.5', linewidth=0.8)
    axes.set(title='One-step error of each network; the test part is right of the line',
             xlabel='sample', ylabel='|error| [1]')
    axes.legend()
