"""Figures 4 to 6 and 8 to 13 of [L18], in its axes, with what is computed here."""
from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
import numpy as np
from scipy.signal import lfilter
from scipy.stats import probplot

from hydro_twin.arrays import FloatArray
from hydro_twin.studies.l18.closed_loop import Run
from hydro_twin.studies.l18.flow_characteristic import FlowCharacteristic
from hydro_twin.studies.l18.linear_loop import exact_equivalent, PUBLISHED, Weights
from hydro_twin.studies.l18.published_method import PublishedFit

SIZE = (6.4, 3.6)               # inches
POINTS = 85                     # that figure 8 shows
SAMPLES = 140                   # that figure 13 shows
NOMINAL = 1000.0                # MW, of the unit of [L18]


def draw_fit(fit: PublishedFit, rivals: Mapping[str, FloatArray]) -> dict[str, Figure]:
    """Draw the figures 8 to 11 for a fit, by name.

    Args:
        fit: of the 5-1-1 network, which is the BP network of [L18].
        rivals: predictions of the other networks, see `predict_rivals`.
    """
    every = slice(None, None, max(1, len(fit.data.raw) // POINTS))
    return {'figure_8': prefilter(fit.data.raw[every], fit.data.opening[every]),
            'figure_9': quantiles(fit),
            'figure_10': prediction_error(fit),
            'figure_11': errors_of_networks(fit, rivals)}


def residual_figures(fit: PublishedFit) -> dict[str, float]:
    """Compute the two correlations of [L18] over the training samples.

    Returns:
        `qq`: of the residual's quantiles with the normal ones; `fit`: of prediction and opening.
    """
    train = fit.data.train
    _, (_, _, qq) = probplot(_residual(fit)[:train])
    correlation = np.corrcoef(fit.predicted[:train], fit.data.opening[:train])[0, 1]
    return {'qq': float(qq), 'fit': float(correlation)}


def _residual(fit: PublishedFit) -> FloatArray:
    return fit.data.opening - fit.predicted


def flow_curve(curve: FlowCharacteristic) -> Figure:
    """Figure 4: steam flow against opening."""
    figure, axes = _axes('valve opening [100 %]', 'steam flow [100 %]')
    opening = np.linspace(0, curve.d_1, 200)
    axes.plot(opening, curve(opening))
    axes.plot(curve.opening, curve.flow, '.', color='C0')
    axes.axvline(curve.d_1, color='0.5', linestyle=':', label=f'd_1 = {curve.d_1:g}')
    axes.set(xlim=(0, 1.1), ylim=(0, 1.1), xticks=np.arange(0, 1.11, 0.1),
             yticks=np.arange(0, 1.11, 0.1))
    axes.legend(loc='lower right')
    return figure


def discretisation(T: float) -> Figure:
    """Figure 5, (c) and (d): a command held at each sample, and what the loop makes of it."""
    figure = Figure(figsize=(SIZE[0], 4.5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True)
    t = np.linspace(0, 1, 1000, endpoint=False)
    every = round(T / t[1])
    u = np.sin(2 * np.pi * t)
    above.plot(t, u, label='u(t)')
    above.plot(t[::every], u[::every], drawstyle='steps-post', label='u*(t), held')
    below.plot(t, response(exact_equivalent(*PUBLISHED, t[1]), u), label='y(t) of u(t)')
    below.plot(t[::every], response(exact_equivalent(*PUBLISHED, T), u[::every]), 'o',
               markersize=4, label='y*(t) of u*(t), discrete')
    above.set(ylabel='u(t), u*(t)', title=f'(c) input, sampled every {1000 * T:g} ms')
    below.set(ylabel='y(t), y*(t)', xlabel='t [s]', title='(d) output')
    for axes in (above, below):
        axes.legend(loc='lower left')
    return figure


def step_responses(equations: Mapping[str, Weights], T: float) -> Figure:
    """Figure 6: step responses of difference equations, by name, over 10 s."""
    figure, axes = _axes('t [s]', 'output for u(t) = 1')
    t = np.arange(0, 10, T)
    for style, (name, weights) in zip(('-', '--', ':'), equations.items(), strict=False):
        with np.errstate(over='ignore', invalid='ignore'):      # one is unstable
            axes.plot(t, np.clip(response(weights, np.ones(len(t))), -1, 3), style, label=name)
    axes.set(xlim=(0, 10), ylim=(0, 1.35), yticks=np.arange(0, 1.26, 0.25))
    axes.legend(loc='lower right')
    return figure


def response(weights: Weights, command: FloatArray) -> FloatArray:
    """Run a difference equation from rest."""
    return np.asarray(lfilter([0.0, *weights.v], [1.0, *(-n for n in weights.n)], command))


def prefilter(raw: FloatArray, filtered: FloatArray) -> Figure:
    """Figure 8: an opening before and after the Butterworth filter [1]."""
    figure, axes = _axes('sampling point', 'valve opening [%]')
    axes.plot(100 * raw, label='original')
    axes.plot(100 * filtered, '--', label='filtered')
    axes.legend()
    return figure


def quantiles(fit: PublishedFit) -> Figure:
    """Figure 9: the training residual's quantiles against normal ones."""
    figure, axes = _axes('normal quantile', 'residual [%]')
    (normal, ordered), (slope, intercept, R) = probplot(100 * _residual(fit)[:fit.data.train])
    axes.plot(normal, ordered, '.', markersize=3)
    axes.plot(normal, slope * normal + intercept, label=f'R = {R:.4f}')
    axes.legend()
    return figure


def prediction_error(fit: PublishedFit) -> Figure:
    """Figure 10: the 5-1-1 network's error over the test samples, in per cent of full opening."""
    error = -100 * _residual(fit)[fit.data.train:]
    figure = Figure(figsize=SIZE, layout='constrained')
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        axes.plot(1 + np.arange(len(error)), error, '.-', markersize=3, linewidth=0.6)
        axes.set(xlabel='predicting sample', ylabel='error of predicting [%]')
    left.set(ylim=(-3, 3), title="the paper's axes")
    right.set(title='enlarged')
    return figure


def errors_of_networks(fit: PublishedFit, rivals: Mapping[str, FloatArray]) -> Figure:
    """Figure 11: signed errors of the networks, in per cent of full opening."""
    train = fit.data.train
    errors = {name: 100 * (run - fit.data.opening)
              for name, run in {'5-1-1': fit.predicted, **rivals}.items()}
    curves = {
        'fitting error of RBF': (errors['rbf'][:train], 's', 'k'),
        'predicting error of BP (5-1-1)': (errors['5-1-1'][train:], 'o', 'r'),
        'fitting error of BP (5-1-1)': (errors['5-1-1'][:train], '^', 'b'),
        'predicting error of BP, 10 units': (errors['bp'][train:], '.', 'C1'),
        'fitting error of BP, 10 units': (errors['bp'][:train], '.', 'C2'),
    }
    figure = Figure(figsize=(SIZE[0], 4.5), layout='constrained')
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        for name, (error, marker, colour) in curves.items():
            axes.plot(1 + np.arange(len(error)), error, marker, color=colour, markersize=2,
                      label=name)
        axes.set(xlim=(0, 600), xlabel='sampling point', ylabel='error [%]')
    left.set(ylim=(-4, 4), title="the paper's axes")
    right.set(title='enlarged')
    figure.legend(*left.get_legend_handles_labels(), loc='outside lower center', ncols=2,
                  markerscale=3)
    return figure


def frequency_control_scheme() -> Figure:
    """Figure 12: the loop of primary frequency control."""
    figure = Figure(figsize=(SIZE[0], 2.6), layout='constrained')
    axes = figure.subplots()
    axes.set(xlim=(0, 10), ylim=(0, 4))
    axes.axis('off')
    for x, y, text in ((2.2, 2.6, 'power PID'), (4.6, 2.6, 'valve servo'),
                       (7.0, 2.6, 'flow curve,\nturbine'), (2.2, 0.6, 'speed droop')):
        axes.add_patch(Rectangle((x, y - 0.5), 1.6, 1.0, fill=False))
        axes.text(x + 0.8, y, text, ha='center', va='center', fontsize=9)
    for start, end in (((0.2, 2.6), (1.1, 2.6)), ((1.5, 2.6), (2.2, 2.6)),
                       ((3.8, 2.6), (4.6, 2.6)), ((6.2, 2.6), (7.0, 2.6)),
                       ((8.6, 2.6), (9.8, 2.6)), ((0.2, 0.6), (2.2, 0.6)),
                       ((1.3, 3.7), (1.3, 2.8))):
        axes.annotate('', end, start, arrowprops={'arrowstyle': '->'})
    axes.plot([9.2, 9.2, 1.3, 1.3], [2.6, 3.7, 3.7, 3.6], 'k', linewidth=1)
    axes.plot([3.8, 4.2, 4.2, 1.3], [0.6, 0.6, 1.5, 1.5], 'k', linewidth=1)
    axes.annotate('', (1.3, 2.4), (1.3, 1.5), arrowprops={'arrowstyle': '->'})
    axes.plot(1.3, 2.6, 'o', color='k', markersize=9, fillstyle='none')
    for x, y, text in ((0.1, 2.85, 'load'), (0.1, 0.85, 'frequency'), (4.02, 2.85, 'u'),
                       (6.3, 2.85, 'opening'), (9.3, 2.85, 'power'), (1.0, 3.0, '-')):
        axes.text(x, y, text, fontsize=8)
    return figure


def events(runs: Mapping[str, Run], sample_time: float, duration: float,
           paper_axes: bool) -> Figure:
    """Figure 13: opening and power of servos, by name, at 140 sampling points.

    Args:
        runs: from the start of the event.
        sample_time: of the runs [s].
        duration: what the sampling points span [s].
        paper_axes: whether 68 to 84 % and 890 to 950 MW are shown, or what the runs reach.
    """
    figure = Figure(figsize=(SIZE[0], 5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True)
    shown = np.linspace(0, duration / sample_time, SAMPLES, endpoint=False).astype(int)
    for style, (name, run) in zip(('-', '--'), sorted(runs.items(), reverse=True), strict=True):
        above.plot(100 * run.opening[shown], style, label=name)
        below.plot(NOMINAL * run.power[shown], style, label=name)
    above.set(ylabel='valve opening [%]', title='(a) valve opening')
    below.set(ylabel='power [MW]', title='(b) power', xlabel='sampling point', xlim=(0, SAMPLES))
    if paper_axes:
        above.set(ylim=(68, 84))
        below.set(ylim=(888, 952))
    for axes in (above, below):
        axes.legend(loc='lower right')
    return figure


def _axes(x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=SIZE, layout='constrained')
    axes = figure.subplots()
    axes.set(xlabel=x, ylabel=y)
    return figure, axes
