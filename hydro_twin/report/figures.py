"""The figures of a trace: measured and predicted, effects at their ports, spectra."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import signal

from hydro_twin.effects.curve import values
from hydro_twin.plants import Port
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import first_scored, predict
from hydro_twin.recording.series import Series
from hydro_twin.report.chart import (
    AFTER,
    axis,
    BEFORE,
    Chart,
    Curve,
    FOUND,
    Illustration,
    MEASURED,
    QUIET,
    thin,
    View,
)
from hydro_twin.report.shape import illustrate_effect
from hydro_twin.report.summary import effect_estimates
from hydro_twin.residual.curve import Found
from hydro_twin.residual.structure import Dependence
from hydro_twin.residual.trace import Trace
from hydro_twin.residual.verdict import Verdict

POINTS = 24_000         # of one curve, over all parts together
SEGMENT = 1024          # samples, of a spectrum
SHOWN = 3               # dependences
FINE = 161              # points of a curve


@dataclass(frozen=True)
class Run:
    """A series with the free runs of the model before and after, as they are reported.

    Attributes:
        label: 'test 1', 'training 2', ...
        first: index of the first sample that is scored.
    """

    label: str
    series: Series
    measured: FloatArray
    first: int
    before: FloatArray
    after: FloatArray


def runs(trace: Trace) -> list[Run]:
    """Run both models over all series, those that were not fitted first."""
    plant = trace.plant
    labelled = [(f'{name} {k + 1}', series) for name, part in
                (('test', 'test'), ('training', 'train'))
                for k, series in enumerate(trace.recordings[part].series)]
    before, after = (predict(Analytical(fit.candidate.model()), [s for _, s in labelled],
                             'free_run') for fit in (trace.before, trace.final))
    return [Run(label, series, series[plant.output.name],
                first_scored(series, plant, 'free_run'), one, other)
            for (label, series), one, other in zip(labelled, before, after, strict=True)
            if len(series) > first_scored(series, plant, 'free_run')]


def illustrations(trace: Trace, verdict: Verdict, ran: Sequence[Run]) -> list[Illustration]:
    """List the figures of the page, in its order."""
    fit = trace.final
    effects = [illustrate_effect(fit, fit.candidate.effects[judged.finding.index], trace.fitted)
               for judged in verdict.judged]
    found = ([_curve(trace.found)] if trace.found else
             [_dependence(dependence) for dependence in trace.depends_on[:SHOWN]])
    return [_output(trace, ran), *effects, *found, _spectra(trace, ran)]


def _names(trace: Trace) -> tuple[tuple[str, str], ...]:
    """Name the models shown, with their colours."""
    if trace.changed:
        return ('before', BEFORE), ('after', AFTER)
    return (('model', BEFORE),)


def _output(trace: Trace, ran: Sequence[Run]) -> Illustration:
    """Measured and predicted over time, and their difference, part by part."""
    sample_time, output = trace.before.candidate.sample_time, trace.plant.output
    most = max(200, POINTS // len(ran))
    views = []
    for run in ran:
        time = sample_time * np.arange(len(run.measured), dtype=np.float64)
        models = [(name, y, colour) for (name, colour), y in
                  zip(_names(trace), (run.before, run.after), strict=False)]
        measured, first = run.measured, run.first
        above = Chart('time [s]', axis(output.meaning, output.unit), (
            Curve('measured', *thin(time, measured, most), MEASURED, 'thick'),
            *(Curve(name, *thin(time, y, most), colour) for name, y, colour in models)))
        below = Chart('time [s]', axis('residual', output.unit), tuple(
            Curve(name, *thin(time[first:], (measured - y)[first:], most), colour)
            for name, y, colour in models), height=0.6)
        source = Path(run.series.source).name
        views.append(View(f'{run.label}, {source}' if source else run.label, (above, below)))
    caption = (
        f'Above, the {output.meaning} as measured and in free run, from rest at the first sample '
        f'measured of each series. Below, the residual: measured less predicted, without the '
        f'start-up of each series, {trace.plant.start_up:g} s, which is not scored. '
        f'Nothing was fitted to the test parts.')
    if any(len(run.measured) > most for run in ran):
        caption += ' Long parts are drawn by the least and the largest of every few samples.'
    return Illustration('output', 'Measured and predicted', caption, tuple(views))


def _curve(found: Found) -> Illustration:
    """Show the curve that is in the model without a name."""
    placed = found.placed
    what, x_label = _signal(placed.port, placed.effect.reads[0])
    spread = effect_estimates(found.fit)[-1]
    low, high, *added = (entry['value'] for entry in spread.values())
    knots = np.linspace(low, high, len(added))
    error = np.array([entry['std_error'] or 0.0 for entry in spread.values()][2:])
    x = np.linspace(low, high, FINE)
    y, place = values(placed, x), np.linspace(-1.0, 1.0, FINE)
    bent = y - np.polyval(np.polyfit(place, y, 1), place)
    return Illustration(
        f'found_{placed.port.name}_{placed.effect.reads[0]}',
        f'Found, not explained: {what} at the {placed.port.name}',
        f'Above, the shape: what the curve adds to the {placed.port.meaning}, less a straight '
        f'line, which a parameter or a bias often gives as well. Below, the curve as it is in the '
        f'model, fitted with all parameters; bars are two standard errors.',
        (View('', (
            Chart(x_label, axis('added, bent', placed.port.unit), (
                Curve('less a straight line', x, bent, FOUND),), height=0.6),
            Chart(x_label, axis('added', placed.port.unit), (
                Curve('free curve', x, y, FOUND),
                Curve('knots', knots, np.array(added), FOUND, 'points', 2.0 * error))))),))


def _signal(port: Port, signal: str) -> tuple[str, str]:
    """Name a signal at a port, and label its axis."""
    what = port.meaning if signal == 'value' else signal.replace('_', ' ')
    return what, axis(what, port.unit if signal == 'value' else port.signals[signal])


def _dependence(found: Dependence) -> Illustration:
    """Show a free curve at a port that explains some of what is left."""
    port = found.port
    what, x_label = _signal(port, found.signal)
    return Illustration(
        f'left_{port.name}_{port.kind}_{found.signal}',
        f'Found, not explained: {what} at the {port.name}',
        f'A free curve that would have to be added to the {port.meaning}. It explains '
        f'{found.share:.1%} of what is left, in blocks that it was not fitted to. What re-tuning '
        f'could do is left out, so a straight line more or less means nothing.',
        (View('', (Chart(x_label, axis('added', port.unit), (
            Curve('free curve', found.knots, found.curve, FOUND),)),)),))


def _spectra(trace: Trace, ran: Sequence[Run]) -> Illustration:
    """Spectra of what the models leave, beside the noise floor."""
    rate = 1.0 / trace.before.candidate.sample_time
    curves = []
    for k, (name, colour) in enumerate(_names(trace)):
        left = [(run.measured - (run.before, run.after)[k])[run.first:] for run in ran]
        frequency, density = spectrum(left, rate)
        curves.append(Curve(name, frequency[1:], density[1:], colour))
    level = trace.floor / np.sqrt(rate / 2.0)
    curves.append(Curve('noise, estimated', frequency[[1, -1]], np.full(2, level), QUIET, 'dash'))
    low, high = (float(f(curves[0].y)) for f in (np.nanmin, np.nanmax))
    curves += [Curve(f'line at {line.frequency:.4g} Hz', np.full(2, line.frequency),
                     np.array([low, high]), FOUND, 'dash') for line in trace.lines]
    return Illustration(
        'spectra', 'Spectrum of the residual',
        'Amplitude density of measured less predicted over all parts, free run. The noise floor '
        'is estimated from the upper third of the frequencies.',
        (View('', (Chart('frequency [Hz]', f'amplitude [{trace.plant.output.unit}/√Hz]',
                         tuple(curves), log=True),)),))


def spectrum(pieces: Sequence[FloatArray], rate: float) -> tuple[FloatArray, FloatArray]:
    """Average Welch's amplitude density over pieces, each by its length; (f,), (f,)."""
    segment = min(SEGMENT, *(len(piece) for piece in pieces)) if pieces else SEGMENT
    power = np.zeros(segment // 2 + 1)
    for piece in pieces:
        frequency, density = signal.welch(np.nan_to_num(piece), fs=rate, nperseg=segment,
                                          detrend='linear')
        power += density * len(piece)
    return frequency, np.sqrt(power / sum(len(piece) for piece in pieces))
