"""A comparison of methods as an HTML page, a CSV table and a JSON object."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
import csv
from io import StringIO
import json
import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from hydro_twin.errors import UserError
from hydro_twin.predictors.predictor import MODES
from hydro_twin.report.page import environment
from hydro_twin.studies.b19.study import (
    five_numbers,
    mann_whitney,
    PARTS,
    Run,
    Study,
    TITLES,
)

MODE_TITLES = {'one_step': 'one step', 'free_run': 'free run'}
EXPERIMENTS = {'direct': 'as recorded', 'swapped': 'training and test data swapped'}


def summary(studies: Mapping[str, Study]) -> dict[str, Any]:
    """Lay studies out as plain numbers; an error of a run that diverged is None.

    Args:
        studies: by experiment, 'direct' and 'swapped'.
    """
    return {name: _experiment(study) for name, study in studies.items()}


def _experiment(study: Study) -> dict[str, Any]:
    methods = {}
    for method, runs in study.runs.items():
        errors = {(part, mode): study.errors(method, part, mode)
                  for part in PARTS for mode in MODES}
        curves = np.array([run.curve for run in runs])
        methods[method] = {
            'title': TITLES[method],
            'runs': _by_key({key: _numbers(values) for key, values in errors.items()}),
            'five_numbers': _by_key({key: _numbers(five_numbers(values))
                                     for key, values in errors.items()}),
            'diverged': int(np.isinf(errors['test', 'free_run']).sum()),
            'curve': {'min': curves.min(0).tolist(), 'median': np.median(curves, 0).tolist(),
                      'max': curves.max(0).tolist(),
                      'test_mean': _test_mean(runs)},
        }
    p_values = {
        (part, mode): {first: {second: mann_whitney(study.errors(first, part, mode),
                                                    study.errors(second, part, mode))
                               for second in study.runs} for first in study.runs}
        for part in PARTS for mode in MODES}
    return {'patterns': dict(study.patterns), 'persistence': dict(study.persistence),
            'unconstrained': dict(study.unconstrained), 'methods': methods,
            'mann_whitney': _by_key(p_values)}


def _test_mean(runs: Sequence[Run]) -> list[float] | None:
    """Average the test errors of networks as they learn; None for other methods."""
    curves = [run.test_curve for run in runs if run.test_curve is not None]
    return np.mean(curves, axis=0).tolist() if curves else None


def _by_key(values: Mapping[tuple[str, str], Any]) -> dict[str, dict[str, Any]]:
    return {part: {mode: values[part, mode] for mode in MODES} for part in PARTS}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]


def table(experiments: Mapping[str, Any]) -> str:
    """Write every single error as a row of a CSV table."""
    text = StringIO()
    writer = csv.writer(text)
    writer.writerow(('experiment', 'method', 'run', 'part', 'mode', 'rms'))
    for name, experiment in experiments.items():
        for method, found in experiment['methods'].items():
            for part in PARTS:
                for mode in MODES:
                    for run, error in enumerate(found['runs'][part][mode]):
                        writer.writerow((name, method, run, part, mode,
                                         'diverged' if error is None else repr(error)))
    return text.getvalue()


def page(result: Mapping[str, Any]) -> str:
    """Write the HTML page, which needs no other file."""
    pages = environment('studies/b19')
    pages.filters |= {'rms': lambda value: 'diverged' if value is None else f'{value:.5g}',
                      'p': lambda value: f'{value:.2g}'}
    figures = {name: {'curves': learning_curves(experiment, result['unit']),
                      'boxes': box_plots(experiment, result['unit'])}
               for name, experiment in result['experiments'].items()}
    return pages.get_template('comparison.html').render(
        result=result, figures=figures, experiment_titles=EXPERIMENTS, parts=PARTS, modes=MODES,
        mode_titles=MODE_TITLES, titles=TITLES)


def learning_curves(experiment: Mapping[str, Any], unit: str) -> str:
    """Draw how every method learns, as SVG; on the right [B19] Fig. 2.

    That is the test error of the networks, averaged over the runs, with a line for the best
    result of the BA. On the left is the training error of the optimisers, which it does not show.
    """
    figure = Figure(figsize=(10, 4), layout='constrained')
    left, right = figure.subplots(1, 2)
    for method, found in experiment['methods'].items():
        curve = found['curve']
        if method == 'least_squares':
            continue                        # a curve over starts, not cycles
        step = range(1, len(curve['median']) + 1)
        if curve['test_mean'] is not None:
            right.plot(step, curve['test_mean'], label=found['title'])
            continue
        line, = left.plot(step, curve['median'], label=found['title'])
        left.fill_between(step, curve['min'], curve['max'], color=line.get_color(), alpha=0.2,
                          linewidth=0)
    left.axhline(experiment['unconstrained']['train'], color='black', linestyle=':',
                 label='linear without constraint')
    right.axhline(min(experiment['methods']['bees']['runs']['test']['one_step']), color='black',
                  linestyle='--', label='best of the BA')
    left.set(xlabel='cycle of 100 candidates', ylabel=f'RMS in training, median [{unit}]')
    right.set(xlabel='epoch', ylabel=f'RMS in test, mean [{unit}]')
    for axes in (left, right):
        axes.set(xscale='log', yscale='log')
        axes.legend()
    return svg(figure, 'curves')


def box_plots(experiment: Mapping[str, Any], unit: str) -> str:
    """Draw the errors of all runs as box plots, [B19] Fig. 3, as SVG."""
    figure = Figure(figsize=(10, 7), layout='constrained')
    grid = figure.subplots(2, 2)
    for row, mode in enumerate(MODES):
        for column, part in enumerate(PARTS):
            _box_plot(grid[row, column], experiment, part, mode)
        grid[row, 0].set_ylabel(f'RMS, {MODE_TITLES[mode]} [{unit}]')
    return svg(figure, 'boxes')


def _box_plot(axes: Axes, experiment: Mapping[str, Any], part: str, mode: str) -> None:
    methods = experiment['methods'].values()
    runs = [[error for error in found['runs'][part][mode] if error is not None]
            for found in methods]
    axes.boxplot(runs, whis=(0, 100))
    axes.set_xticks(range(1, len(runs) + 1), [found['title'] for found in methods])
    axes.set(title=part, yscale='log')
    if mode == 'one_step':
        axes.axhline(experiment['persistence'][part], color='tab:red', linestyle='--',
                     label='last sample repeated')
        axes.axhline(experiment['unconstrained'][part], color='black', linestyle=':',
                     label='linear without constraint')
        axes.legend(fontsize='small')


def svg(figure: Figure, salt: str) -> str:
    """Render a figure to be put into a page; the salt keeps the names inside it apart."""
    text = StringIO()
    with rc_context({'svg.hashsalt': salt, 'svg.fonttype': 'none'}):
        figure.savefig(text, format='svg', metadata={'Date': None})
    drawing = text.getvalue()
    return drawing[drawing.index('<svg'):]


def write_comparison(result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write comparison.html, .csv and .json, all or none.

    Args:
        result: with 'experiments' as `summary` gives it, 'plant', 'unit', 'bags' and 'runs'.
        folder: made if it is not there.

    Raises:
        UserError: the folder cannot be written to.
    """
    texts = {'html': page(result), 'csv': table(result['experiments']),
             'json': json.dumps(result, allow_nan=False, indent=1)}
    texts = {f'comparison.{kind}': text for kind, text in texts.items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder) as beside:
            for name, text in texts.items():
                (Path(beside) / name).write_text(text, encoding='utf-8', newline='')
            for name in texts:
                (Path(beside) / name).replace(folder / name)
    except OSError as error:
        raise UserError(f'{folder}: cannot be written to ({error.strerror})') from error
    return [folder / name for name in texts]
