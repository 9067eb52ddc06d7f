"""The published identification of the valve servo against least squares, at several noises.

Run: python -m benchmarks.valve_identification. It prints the table of docs/valve_servo.md: errors
against the truth, medians over draws of the noise, the same recordings for all.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydro_twin.recording.series import Recording, Series
from hydro_twin.simulation.sensor import measure
from hydro_twin.valve.demonstration import simulated_steps, STEPS
from hydro_twin.valve.direct import fit_free_run, fit_one_step, NAMES
from hydro_twin.valve.figures import residual_figures
from hydro_twin.valve.flow_characteristic import default_characteristic
from hydro_twin.valve.linear_loop import LoopParameters, PUBLISHED
from hydro_twin.valve.published_method import fit_published

NOISES = (0.0, 1e-5, 1e-4, 5e-4, 2e-3)
DRAWS = 5
KEPT = (1, 5)      # every how many of the samples, 2 ms apart, are kept


def reading(parameters: LoopParameters | str) -> Mapping[str, float] | None:
    return None if isinstance(parameters, str) else parameters._asdict()


def fits(recording: Recording, correlations: list[float]) -> dict[str, Mapping[str, float] | None]:
    published = fit_published(recording, PUBLISHED.k_1)
    correlations.append(residual_figures(published)['fit'])
    direct = {'free run': fit_free_run, 'one step': fit_one_step}
    return {
        **{f'least squares, {how}': {
            name: estimate.value if estimate.identifiable else np.nan
            for name, estimate in fit(recording, PUBLISHED.k_1).items()}
           for how, fit in direct.items()},
        'network, read by its poles': reading(published.exact),
        'network, read by eq. 3': reading(published.printed),
    }


def error(found: Sequence[Mapping[str, float] | None], name: str) -> str:
    true = getattr(PUBLISHED, name)
    values = [f[name] for f in found if f is not None and np.isfinite(f[name])]
    if len(values) <= DRAWS // 2:
        return 'none'
    percent = 100 * np.median(np.abs(np.array(values) / true - 1))
    return '< 0.01' if percent < 0.01 else f'{percent:.{2 if percent < 10 else 0}f}'


def table(recordings: Mapping[float, Sequence[Recording]]) -> None:
    correlations: list[float] = []
    for row, (noise, draws) in enumerate(recordings.items()):
        found = [fits(recording, correlations) for recording in draws]
        if row == 0:
            print(f'| noise [1] | {" | ".join(found[0])} |')
            print('|---' * (1 + len(found[0])) + '|')
        errors = [' / '.join(error([f[method] for f in found], name) for name in NAMES)
                  for method in found[0]]
        print(f'| {noise:g} | {" | ".join(errors)} |', flush=True)
    print('\nLeast correlation of prediction and opening, network: '
          f'{100 * min(correlations):.6f} %')


def noisy(series: Series, noise: float, draw: int) -> Recording:
    measured, _ = measure(series, 'opening', None, noise, 0.0, np.random.default_rng(draw))
    return Recording((measured,))


def main() -> None:
    clean = simulated_steps(STEPS, default_characteristic())
    for every in KEPT:
        kept = replace(clean, sample_time=clean.sample_time * every,
                       columns={name: column[::every] for name, column in clean.columns.items()})
        print(f'\nSamples every {1000 * kept.sample_time:g} ms: '
              f'errors of {", ".join(NAMES)} [%]\n')
        table({noise: [noisy(kept, noise, draw) for draw in range(DRAWS)] for noise in NOISES})


if __name__ == '__main__':
    main()
