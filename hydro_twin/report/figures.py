"""The figures of a trace: measured and predicted, effects at their ports, spectra."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import signal

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed
from hydro_twin.effects.curve import values
from hydro_twin.model import Model
from hydro_twin.plants import Plant, Port
from hydro_twin.report.chart import (
    AFTER,
    axis,
    BEFORE,
    Chart,
    Curve,
    envelope,
    FOUND,
    Illustration,
    MEASURED,
    QUIET,
    View,
)
from hydro_twin.report.summary import effect_estimates, meaning
from hydro_twin.result import (
    Dependence,
    NamedEffect,
    OverTime,
    Profile,
    Shape,
    TIME,
    TraceResult,
)

POINTS = 24_000         # of one curve, over all parts together
SEGMENT = 1024          # samples, of a spectrum
SHOWN = 3               # dependences
FINE = 161              # points of a curve


def illustrations(result: TraceResult) -> list[Illustration]:
    """List the figures of the page, in its order."""
    effects = [_effect(effect, shape, result.plant)
               for effect, shape in zip(result.effects, result.shapes, strict=True)]
    found = ([_curve(result.curve.placed, result.after)] if result.curve else
             [_dependence(dependence) for dependence in result.remainder.depends_on[:SHOWN]])
    return [_output(result), *effects, *found, _spectra(result)]


def _names(result: TraceResult) -> tuple[tuple[str, str], ...]:
    """Name the models shown, with their colours."""
    if result.changed:
        return ('before', BEFORE), ('after', AFTER)
    return (('model', BEFORE),)


def _output(result: TraceResult) -> Illustration:
    """Measured and predicted over time, and their difference, part by part."""
    sample_time, output = result.before.sample_time, result.plant.output
    most = max(200, POINTS // len(result.runs))
    views = []
    for run in result.runs:
        time = sample_time * np.arange(len(run.measured), dtype=np.float64)
        models = [(name, y, colour) for (name, colour), y in
                  zip(_names(result), (run.before, run.after), strict=False)]
        measured, first = run.measured, run.first
        above = Chart('time [s]', axis(output.meaning, output.unit), (
            Curve('measured', *envelope(time, measured, most), MEASURED, 'thick'),
            *(Curve(name, *envelope(time, y, most), colour) for name, y, colour in models)))
        below = Chart('time [s]', axis('residual', output.unit), tuple(
            Curve(name, *envelope(time[first:], (measured - y)[first:], most), colour)
            for name, y, colour in models), height=0.6)
        source = Path(run.series.source).name
        views.append(View(f'{run.label}, {source}' if source else run.label, (above, below)))
    seconds = result.before.start_up * result.before.sample_time
    caption = (
        f'Above, the {output.meaning} as measured and in free run, from rest at the first sample '
        f'measured of each series. Below, the residual: measured less predicted, without the '
        f'start-up of each series, {seconds:g} s, which is not scored. '
        f'Nothing was fitted to the test parts.')
    if any(len(run.measured) > most for run in result.runs):
        caption += ' Long parts are drawn by the least and the largest of every few samples.'
    return Illustration('output', 'Measured and predicted', caption, tuple(views))


def _effect(effect: NamedEffect, shape: Shape | Profile | OverTime, plant: Plant
            ) -> Illustration:
    """Show an effect at its port; of linear dynamics the error over their parameter."""
    title = f'{effect.placed.effect.title.capitalize()} at the {effect.port}'
    name = f'effect_{effect.id}_{effect.port}'
    if isinstance(shape, Profile):
        meaning = effect.placed.effect.parameters[0].meaning.partition(':')[0]
        return Illustration(name, title,
                            f'Error of the free run for other values of the {meaning}, all else '
                            f'as fitted.',
                            (View('', (_profile(effect.placed, shape, plant),)),))
    port = effect.placed.port
    if isinstance(shape, OverTime):
        return Illustration(
            name, f'Drift of {port.name}',
            f'The {port.meaning} over the recording. The points know no law of the drift: at each '
            f'time the value that the recording shows there, all other parameters free; bars are '
            f'two standard errors.',
            (View('', (Chart('time [s]', axis(port.meaning, port.unit), (
                Curve('in the model', shape.time, shape.values, AFTER),
                Curve(shape.free.label, shape.free.knots, shape.free.added, FOUND, 'points',
                      2.0 * shape.free.std_error))),)),))
    _, x_label = _signal(port, shape.signal)
    curves = [Curve('law, as it acts in the run', shape.x, shape.added, AFTER, 'dots')]
    curves += [Curve(free.label, free.knots, free.added, colour, 'points', 2.0 * free.std_error)
               for free, colour in zip(shape.curves, (FOUND, BEFORE), strict=False)]
    caption = (
        f'What is added to the {port.meaning}, over the signal on which that depends most '
        f'plainly. The free curve knows no law: it is fitted to what the model would leave '
        f'without this effect, all else as fitted; bars are two standard errors. Where the law '
        f'is right, its dots pass through the bars.')
    if effect.placed.effect.implicit:
        caption += ' Beside a jump, between two samples, they overshoot.'
    if shape.reads > 2:
        caption += ' This law reads more than one signal: its dots are spread by the others.'
    return Illustration(name, title, caption, (View('', (Chart(
        x_label, axis('added', port.unit), tuple(curves)),)),))


def _profile(placed: Placed, profile: Profile, plant: Plant) -> Chart:
    """Chart the error over the first parameter of an effect."""
    parameter = placed.effect.parameters[0]
    unit = placed.effect.unit(parameter, placed.port)
    return Chart(axis(parameter.name, unit), axis('RMS error', plant.output.unit), (
        Curve('free run', profile.values, profile.errors, BEFORE),
        Curve('as fitted', np.array([placed.values[0]]), np.array([profile.error]), AFTER,
              'points')))


def _curve(placed: Placed, model: Model) -> Illustration:
    """Show the curve that is in the model without a name, its last effect."""
    what, x_label = _signal(placed.port, placed.effect.reads[0])
    spread = effect_estimates(model)[-1]
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
    what = meaning(port, signal)
    return what, axis(what, {'value': port.unit, TIME: 's', **port.signals}[signal])


def _dependence(found: Dependence) -> Illustration:
    """Show a free curve at a port that explains some of what is left."""
    port = found.port
    what, x_label = _signal(port, found.signal)
    return Illustration(
        f'left_{port.name}_{port.kind}_{found.signal}',
        f'Found, not explained: {what} at the {port.name}',
        f'A free curve that would have to be added to the {port.meaning}. It explains '
        f'{found.share:.1%} of what is left, in blocks that it was not fitted to. What '
        f're-estimated parameters could do is left out, so a straight line more or less means '
        f'nothing.',
        (View('', (Chart(x_label, axis('added', port.unit), (
            Curve('free curve', found.knots, found.curve, FOUND),)),)),))


def _spectra(result: TraceResult) -> Illustration:
    """Spectra of what the models leave, beside the noise floor."""
    rate = 1.0 / result.before.sample_time
    curves = []
    for k, (name, colour) in enumerate(_names(result)):
        left = [(run.measured - (run.before, run.after)[k])[run.first:] for run in result.runs]
        frequency, density = spectrum(left, rate)
        curves.append(Curve(name, frequency[1:], density[1:], colour))
    level = result.noise / np.sqrt(rate / 2.0)
    curves.append(Curve('noise, estimated', frequency[[1, -1]], np.full(2, level), QUIET, 'dash'))
    low, high = (float(f(curves[0].y)) for f in (np.nanmin, np.nanmax))
    curves += [Curve(f'line at {line.frequency:.4g} Hz', np.full(2, line.frequency),
                     np.array([low, high]), FOUND, 'dash') for line in result.remainder.lines]
    return Illustration(
        'spectra', 'Spectrum of the residual',
        'Amplitude density of measured less predicted over all parts, free run. The noise floor '
        'is estimated from the upper third of the frequencies.',
        (View('', (Chart('frequency [Hz]', f'amplitude [{result.plant.output.unit}/√Hz]',
                         tuple(curves), log=True),)),))


def spectrum(pieces: Sequence[FloatArray], rate: float) -> tuple[FloatArray, FloatArray]:
    """Average Welch's amplitude density over pieces, each by its length; (f,), (f,).

    Pieces of less than half of the longest may be left out: a few samples between two gaps must
    not limit the resolution of all.
    """
    segment = min(SEGMENT, max(map(len, pieces)) // 2)
    long = [piece for piece in pieces if len(piece) >= segment]
    power = np.zeros(segment // 2 + 1)
    for piece in long:
        frequency, density = signal.welch(np.nan_to_num(piece), fs=rate, nperseg=segment,
                                          detrend='linear')
        power += density * len(piece)
    return frequency, np.sqrt(power / sum(len(piece) for piece in long))
