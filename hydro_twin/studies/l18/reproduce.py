"""Remake every table and figure of docs/valve_servo.md.

Run it as `python -m hydro_twin.studies.l18.reproduce PAGE`: the blocks of the page, each between
two comments, are rewritten, and the figures go to img/l18 beside it. It takes some minutes.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
import re
import sys
from tempfile import TemporaryDirectory
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from hydro_twin.errors import UserError
from hydro_twin.files import write_whole
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.progress import progress
from hydro_twin.recording.rig import read, rig_of
from hydro_twin.recording.series import Recording
from hydro_twin.report.picture import write_picture
from hydro_twin.share import share_folder
from hydro_twin.studies.l18 import figures
from hydro_twin.studies.l18.closed_loop import agreement, Run
from hydro_twin.studies.l18.direct import NAMES
from hydro_twin.studies.l18.event import LOAD, load_loop_constants, simulated_frequency
from hydro_twin.studies.l18.flow_characteristic import default_characteristic
from hydro_twin.studies.l18.frequency_control import run_both
from hydro_twin.studies.l18.identify import identify
from hydro_twin.studies.l18.limit import with_limit
from hydro_twin.studies.l18.linear_loop import exact_equivalent, PUBLISHED, Weights
from hydro_twin.studies.l18.noise_study import noise_tables, RECORDINGS
from hydro_twin.studies.l18.printed_equation import printed_weights
from hydro_twin.studies.l18.published_method import (
    fit_published,
    predict_rivals,
    prefiltered,
    PublishedFit,
)
from hydro_twin.studies.l18.servo_model import published

STEPS = share_folder() / 'bags' / 'valve_steps'
T = 1e-3                        # s, of the paper's difference equation
TABLE_1 = Weights((7.98e-5, 8.01e-5), (1.96, -0.962, 0.00255))         # as printed
EQUATIONS = {
    "Table 1's weights": TABLE_1,
    'eq. 3 with Table 2': printed_weights(*PUBLISHED, T),
    'exact with Table 2': exact_equivalent(*PUBLISHED, T),
}
CASES = {'figure 13': LOAD, 'end of the travel': 1.0}       # load, of nominal
FIGURE_13 = 70.0                # s that its 140 sampling points span; the paper does not say
FIGURE_5 = 0.05                 # s, coarse enough for samples to be seen
FIGURE_8 = (5.9, 0.01, 85)      # from when, how far apart [s] and how many: from 90 to 50 %
POWER_ERROR, RELATIVE_POWER_ERROR, RELATIVE_OPENING_ERROR = 15.0, 0.0158, 0.05     # of the paper
BLOCK = re.compile(r'(<!-- made: (\w+) -->\n).*?(\n<!-- end -->)', re.DOTALL)


class Results:
    """What the tables and figures show, computed when first asked for."""

    curve = default_characteristic()

    @cached_property
    def recording(self) -> Recording:
        """The sample bag of steps."""
        return read([STEPS], rig_of(VALVE_SERVO))

    @cached_property
    def fit(self) -> PublishedFit:
        """The published method on it."""
        return fit_published(self.recording, PUBLISHED.k_1)

    @cached_property
    def rivals(self) -> dict[str, Any]:
        """The networks that it is compared with."""
        return predict_rivals(self.fit.data)

    @cached_property
    def identification(self) -> dict[str, Any]:
        """What `hydro-twin identify` finds on it."""
        with TemporaryDirectory() as folder:
            return identify(STEPS, self.recording, PUBLISHED.k_1, 0, Path(folder))

    @cached_property
    def events(self) -> dict[str, dict[str, Run]]:
        """Both servos in both cases of primary control."""
        constants = load_loop_constants()
        servo = with_limit(published(), self.curve)
        frequency = simulated_frequency(constants['f_n'], servo.sample_time)
        return {case: run_both(servo, self.curve, frequency, load, constants)
                for case, load in CASES.items()}


def weights(_: Results) -> str:
    """Table 1: weights of the difference equations at 1 ms."""
    rows = []
    for name, equation in EQUATIONS.items():
        v = [f'{value:.4g}' for value in equation.v] + ['none'] * (3 - len(equation.v))
        rows.append([name, *v, *(f'{value:.5g}' for value in equation.n)])
    return _table(['', 'u(k-1)', 'u(k-2)', 'u(k-3)', 'y(k-1)', 'y(k-2)', 'y(k-3)'], rows)


def poles(_: Results) -> str:
    """Poles and step responses of the difference equations."""
    steps = {name: figures.response(equation, np.ones(10_000))
             for name, equation in EQUATIONS.items()}
    true = steps['exact with Table 2']
    rows = []
    for name, equation in EQUATIONS.items():
        z = equation.poles().real
        difference = float(np.abs(steps[name] - true).max())
        rows.append([
            name, ', '.join(f'{pole:.5f}' for pole in z),
            ', '.join('unstable' if pole >= 1 else f'{-T / np.log(pole):.5f}' for pole in z),
            f'{equation.gain():.2f}',
            'none' if difference == 0 else f'{difference:.4f}' if difference < 10 else 'grows'])
    return _table(['', 'poles', 'time constants [s]', 'steady gain',
                   'largest difference of the step response from the exact'], rows)


def reading(results: Results) -> str:
    """Table 2: parameters of the sample bag by every method."""
    found = results.identification
    direct = {how: {name: f'{e["value"]:.5f} ± {e["std_error"]:.5f}' if e['identifiable']
                    else 'not identifiable' for name, e in fit.items()}
              for how, fit in found['least_squares'].items()}
    network = {how: {name: f'{read["parameters"][name]:.5f}' if read['parameters'] else 'none'
                     for name in NAMES}
               for how, read in ((how, found['network'][how])
                                 for how in ('nearest', 'exact', 'printed'))}
    rows = [[name, f'{found["paper"][name]:.5f}', direct['free_run'][name],
             direct['one_step'][name], *(network[how][name] for how in network)] for name in NAMES]
    return _table(['[s]', 'paper, and truth here', 'least squares, free run',
                   'least squares, one step', 'network, nearest loop', 'network, poles',
                   'network, eq. 3'], rows)


def networks(results: Results) -> str:
    """RMS errors of the networks on the sample bag."""
    errors = results.fit.errors(results.rivals)
    titles = {'5-1-1': "5-1-1, the paper's BP", 'rbf': 'RBF, 60 units', 'bp': 'BP, 10 units',
              '5-1-1 free run': '5-1-1, free run'}
    return _table(['RMS error [1]', 'train', 'test'],
                  [[titles[name], *(f'{error[part]:.1e}' for part in ('train', 'test'))]
                   for name, error in errors.items()])


def residual(results: Results) -> str:
    """Figures of merit of the fit, as in the paper."""
    found, data = figures.residual_figures(results.fit), results.fit.data
    error = np.abs(results.fit.predicted - data.opening)[data.train:]
    return _table(['', 'paper', 'here'], [
        ['R of the Q-Q plot', '> 0.99', f'{found["qq"]:.4f}'],
        ['largest prediction error over the test samples', '3 %', f'{100 * error.max():.1e} %'],
        ['correlation of prediction and opening', 'not given', f'{found["fit"]:.8f}']])


def frequency(results: Results) -> str:
    """Steady errors of the linear servo against the nonlinear one."""
    rows = [["the paper's plant", '', '5', '', '1.58']]
    for case, runs in results.events.items():
        rows.append([f'{case}, load {CASES[case]:g}'])
        for signal in ('opening', 'power'):
            linear, nonlinear = (getattr(runs[name], signal) for name in ('linear', 'nonlinear'))
            error = agreement(nonlinear, linear)['relative_error_percent']
            rows[-1] += [f'{100 * linear[-1]:.1f} / {100 * nonlinear[-1]:.1f}',
                         f'{abs(error):.2f}' if abs(error) < 0.005 else f'{error:.2f}']
    return _table(['case', 'opening at the end, linear / nonlinear [%]', 'relative error [%]',
                   'power at the end, linear / nonlinear [%]', 'relative error [%]'], rows)


def unexplained(results: Results) -> str:
    """Find what errors of 5 and 1.58 % would need."""
    opening = float(results.events['figure 13']['nonlinear'].opening[-1])
    more = float(results.curve(opening * (1 + RELATIVE_OPENING_ERROR)) - results.curve(opening))
    power = POWER_ERROR / RELATIVE_POWER_ERROR
    gains = [exact_equivalent(*PUBLISHED[:3], k_1, T).gain() for k_1 in (1.0, PUBLISHED.k_1)]
    return _table(['', 'figure'], [
        ['steady gain of eq. 1 with k_1 = 1 and with 1.093',
         ' and '.join(f'{gain:.3f}' for gain in gains)],
        ['opening of a linear model without k_1, were the feedback taken before it',
         f'{100 * (1 / PUBLISHED.k_1 - 1):.1f} %'],
        ['power to which 15 MW are 1.58 %', f'{power:.0f} MW'],
        [f'power that 5 % more than an opening of {100 * opening:.1f} % gives on the curve here',
         (f'{figures.NOMINAL * more:.0f} MW, {100 * figures.NOMINAL * more / power:.2f} % of '
         f'{power:.0f} MW')]])


def noise(_: Results) -> str:
    """Errors of all methods at several noises."""
    with progress('fitting at several noises', RECORDINGS) as done:
        return noise_tables(done)


BLOCKS: dict[str, Callable[[Results], str]] = {
    block.__name__: block for block in
    (weights, poles, reading, networks, residual, frequency, unexplained, noise)}


def drawings(results: Results) -> dict[str, Figure]:
    """Draw the figures of the page, by name."""
    series = results.recording.series[0]
    begin, apart, points = FIGURE_8
    every = slice(round(begin / series.sample_time), None, round(apart / series.sample_time))
    runs = results.events
    step = published().sample_time
    return {
        'figure_4': figures.flow_curve(results.curve),
        'figure_5': figures.discretisation(FIGURE_5),
        'figure_6': figures.step_responses(EQUATIONS, T),
        **figures.draw_fit(results.fit, results.rivals),
        'figure_8': figures.prefilter(series['opening'][every][:points],
                                      prefiltered(series)['opening'][every][:points]),
        'figure_12': figures.frequency_control_scheme(),
        'figure_13': figures.events(runs['figure 13'], step, FIGURE_13, paper_axes=True),
        'end_of_travel': figures.events(runs['end of the travel'], step, FIGURE_13,
                                        paper_axes=False),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the blocks and the figures; 2 after an error of the user's."""
    parser = argparse.ArgumentParser(
        prog='python -m hydro_twin.studies.l18.reproduce',
        description='Remakes the tables and figures of docs/valve_servo.md.')
    parser.add_argument('page', type=Path, metavar='PAGE', help='docs/valve_servo.md')
    args = parser.parse_args(arguments)
    results = Results()
    try:
        text = args.page.read_text(encoding='utf-8')
        new = BLOCK.sub(lambda found: found[1] + BLOCKS[found[2]](results) + found[3], text)
        drawn = drawings(results)
        folder = args.page.parent / 'img' / 'l18'
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in drawn.items():
            write_picture(figure, folder / f'{name}.png')
        write_whole(args.page, new.encode())
    except (UserError, OSError) as error:
        print(f'{parser.prog}: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    return 0


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a table as Markdown."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


if __name__ == '__main__':
    sys.exit(main())
