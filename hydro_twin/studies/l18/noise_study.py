"""The published identification of the valve servo against least squares, at several noises.

Errors against the truth, medians over draws of the noise, the same recordings for all methods.
"""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.recording.series import Recording, Series
from hydro_twin.simulation.sensor import measure
from hydro_twin.studies.l18.demonstration import simulated_steps, STEPS
from hydro_twin.studies.l18.direct import fit_free_run, fit_one_step, NAMES
from hydro_twin.studies.l18.figures import residual_figures
from hydro_twin.studies.l18.flow_characteristic import default_characteristic
from hydro_twin.studies.l18.linear_loop import LoopParameters, PUBLISHED
from hydro_twin.studies.l18.published_method import fit_published

NOISES = (0.0, 1e-5, 1e-4, 5e-4, 2e-3)      # standard deviations, of full opening
DRAWS = 5
KEPT = (1, 5)           # every how many of the samples, 2 ms apart, are kept
RECORDINGS = len(KEPT) * sum(DRAWS if noise else 1 for noise in NOISES)     # without noise, one

Found = Mapping[str, float] | None          # parameters by name; nan where not identifiable


def noise_tables(done: Callable[[], object] = lambda: None) -> str:
    """Write the tables as Markdown.

    Args:
        done: called after each recording, of `RECORDINGS`.
    """
    clean = simulated_steps(STEPS, default_characteristic())
    text = []
    for every in KEPT:
        kept = replace(clean, sample_time=clean.sample_time * every,
                       columns={name: column[::every] for name, column in clean.columns.items()})
        text += [f'Samples every {1000 * kept.sample_time:g} ms:', '', *_table(kept, done), '']
    return '\n'.join(text).rstrip()


def _table(clean: Series, done: Callable[[], object]) -> list[str]:
    """Fit draws of every noise, and write the medians of the errors."""
    rows, correlations = [], []
    for noise in NOISES:
        found: list[dict[str, Found]] = []
        for draw in range(DRAWS if noise else 1):
            measured, _ = measure(clean, 'opening', None, noise, 0.0, np.random.default_rng(draw))
            fits, correlation = _fits(Recording((measured,)))
            found.append(fits)
            correlations.append(correlation)
            done()
        errors = [' / '.join(_error([fits[method] for fits in found], name) for name in NAMES)
                  for method in found[0]]
        rows.append(f'| {noise:g} | {" | ".join(errors)} |')
    least = f'Least correlation of prediction and opening, 5-1-1: {100 * min(correlations):.6f} %.'
    return [f'| noise [1] | {" | ".join(found[0])} |', '|---' * (1 + len(found[0])) + '|', *rows,
            '', least]


def _fits(recording: Recording) -> tuple[dict[str, Found], float]:
    """Fit one recording by every method, and correlate prediction and opening."""
    published = fit_published(recording, PUBLISHED.k_1)
    direct = {'free run': fit_free_run, 'one step': fit_one_step}
    edge = published.nearest.at_edge
    return {
        **{f'least squares, {how}': {
            name: estimate.value if estimate.identifiable else np.nan
            for name, estimate in fit(recording, PUBLISHED.k_1).items()}
           for how, fit in direct.items()},
        'network, nearest loop': {
            name: np.nan if name in edge else value
            for name, value in published.nearest.parameters._asdict().items()},
        'network, poles': _read(published.exact),
        'network, eq. 3': _read(published.printed),
    }, residual_figures(published)['fit']


def _read(parameters: LoopParameters | str) -> Found:
    return None if isinstance(parameters, str) else parameters._asdict()


def _error(found: Sequence[Found], name: str) -> str:
    """Write the median error of a parameter in per cent, 'none' where most have no value."""
    true = getattr(PUBLISHED, name)
    values = [f[name] for f in found if f is not None and np.isfinite(f[name])]
    if len(values) <= len(found) // 2:
        return 'none'
    percent = 100 * np.median(np.abs(np.array(values) / true - 1))
    return '< 0.01' if percent < 0.01 else f'{percent:.{2 if percent < 10 else 0}f}'
