"""The result of a trace as one plain object: `report.json`."""
from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.fitting.free_run import Fit, get, label, Unknown
from hydro_twin.model import Estimate, FittedEffect, Model
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import errors_by_series, persistence, rms
from hydro_twin.residual.structure import drifts
from hydro_twin.residual.trace import SIXTH, THIRD, Trace
from hydro_twin.residual.verdict import (
    CLOSE,
    is_structured,
    Judged,
    LIKELY,
    Verdict,
)

TESTED = {
    0: 'bags that were not fitted',
    THIRD: 'the first third of every series, which was not fitted',
    SIXTH: 'the second sixth of every series, which was not fitted; the first was, since more '
           'happens in the first third than in the rest',
}


def summarise(trace: Trace, verdict: Verdict) -> dict[str, Any]:
    """Lay out a trace as the object of `report.json`; errors are RMS in the output's unit."""
    after = trace.final
    estimates = effect_estimates(after)
    return {
        'plant': trace.plant.name,
        'verdict': verdict.kind,
        'says': sentence(trace, verdict),
        'tested': TESTED[trace.tested],
        'effects': [_effect(j, estimates[j.finding.index]) for j in verdict.judged],
        'found': _found(trace, estimates),
        'ambiguous': [list(group) for group in verdict.ambiguous],
        **trace.errors,
        'improvement': {'relative': trace.proof.relative, 'low': trace.proof.low,
                        'high': trace.proof.high},
        'cannot_show': [] if trace.fails else [
            {'id': h.id, 'port': h.port, 'says': h.says} for h in trace.hidden],
        'series': _series(trace),
        'parameters': {'before': parameters(trace.before), 'after': parameters(after)},
        'persistence': {'test': persistence(trace.recordings['test'], trace.plant)},
        'noise_floor': trace.floor,
        'remainder': {
            'white': trace.white,
            'lines_hz': [line.frequency for line in trace.lines],
            'depends_on': [{'port': d.port.name, 'signal': d.signal, 'share': d.share,
                            'p_value': d.p_value}
                           for d in trace.depends_on],
            'when': when(trace),
            'drifts': drifts(trace.drifts),
            'foretold': {'share': trace.foretold[0], 'p_value': trace.foretold[1]},
            'says': remainder_sentence(trace),
        },
    }


def sentence(trace: Trace, verdict: Verdict) -> str:
    """Say the verdict to a person, in one sentence."""
    unit = '' if trace.plant.output.unit == '1' else f' {trace.plant.output.unit}'
    test = [trace.errors[when]['free_run']['test'] for when in ('before', 'after')]
    falls = (f'the free-run error on data it was not fitted to falls from {_short(test[0])} to '
             f'{_short(test[1])}{unit}')
    if verdict.kind == 'nothing_missing':
        return (f'Nothing is missing: the linear model leaves {_short(test[0])}{unit} on data it '
                f'was not fitted to, and no effect earns its place there.')
    if verdict.kind == 'unexplained':
        left = f'Something is left that no known effect explains: {remainder_sentence(trace)}'
        return left + (f'. With a free curve of the {over(trace.found.placed)}, which has no '
                       f'name, {falls}.' if trace.found else '.')
    named = ' and '.join(_named(j) for j in verdict.judged)
    if trace.found:
        named += (f', and something that no known effect explains, a free curve of the '
                  f'{over(trace.found.placed)}')
    return f'The model lacks {named}: with it, {falls}.'


def when(trace: Trace) -> list[dict[str, Any]]:
    """Say when much of what is left comes, if seldom, in seconds from the begin of its bag."""
    parts, candidate = [*trace.train, *trace.test], trace.after.candidate
    sample_time = candidate.sample_time
    begin = {bag: min(part.start for part in parts if part.source == bag)
             for bag in {part.source for part in parts}}
    spells = []
    for burst in trace.bursts:
        part = parts[burst.stretch]
        at = 1e-9 * (part.start - begin[part.source]) + candidate.start_up * sample_time
        spells.append({'bag': part.source, 'from_s': at + burst.begin * sample_time,
                       'to_s': at + burst.end * sample_time})
    return sorted(spells, key=lambda spell: (spell['bag'], spell['from_s']))


def over(placed: Placed) -> str:
    """Say over what a curve is, and where."""
    signal = placed.effect.reads[0]
    what = placed.port.meaning if signal == 'value' else signal.replace('_', ' ')
    return f'{what} at the {placed.port.name}'


def _named(judged: Judged) -> str:
    close = [name for name, distance in judged.rivals if distance < CLOSE]
    where = ' or the '.join((judged.port, *judged.elsewhere))
    text = f'{judged.id.replace("_", " ")} at the {where}'
    if close:
        text = f'{text} (or {" or ".join(name.replace("_", " ") for name in close)})'
    return text if judged.certain else f'something that behaves like {text}'


def remainder_sentence(trace: Trace) -> str:
    """Say what can be said of the residual at the end."""
    hertz = [f'{line.frequency:.1f}' for line in trace.lines]
    parts = [f'a spectral line at {hertz[0]} Hz' if len(hertz) == 1 else
             f'spectral lines at {", ".join(hertz)} Hz'] if hertz else []
    if trace.depends_on:
        first = trace.depends_on[0]
        what = 'value' if first.signal == 'value' else first.signal.replace('_', ' ')
        parts.append(f'it depends on the {what} at the {first.port.name} '
                     f'({first.share:.0%} of what is left)')
    if spells := when(trace):
        first, last = spells[0]['from_s'], spells[-1]['to_s']
        parts.append(f'much of it comes in {sum(s["to_s"] - s["from_s"] for s in spells):.1f} s, '
                     + (f'from {first:.1f} to {last:.1f} s' if len(spells) == 1 else
                        f'in {len(spells)} spells, the first at {first:.1f} s')
                     + (f' of {spells[0]["bag"]}' if spells[0]['bag'] else ''))
    if drifts(trace.drifts):
        parts.append('a parameter drifts over the recording')
    if trace.is_stranger:
        times = trace.unseen / max(trace.after.error, 1e-300)
        parts.append(f'on data that was not fitted the error is {times:.1f} times as large: '
                     'something happens there that does not in the data that was')
    if not parts and trace.is_loud:
        parts.append(f'it is {trace.after.error / trace.floor:.0f} times as large as the noise, '
                     f'but depends on nothing that can be seen at the ports')
    if trace.fails:
        parts.insert(0, f'the model does not fit, by {trace.after.error / trace.floor:.0f} times '
                        f'the noise, so that nothing can be said of other effects')
    if not parts and is_structured(trace, LIKELY):
        parts.append(f'{trace.foretold[0]:.0%} of what is left follows what happens at the ports, '
                     f'by no single curve')
    if parts:
        return '; '.join(parts)
    if trace.white:
        return 'nothing left above the noise'
    return 'what is left has memory, but depends on nothing that the plant does'


def _effect(judged: Judged, estimates: dict[str, Any]) -> dict[str, Any]:
    return {
        'id': judged.id, 'port': judged.port, 'or_ports': list(judged.elsewhere),
        'parameters': estimates,
        'p_value': judged.finding.p_value, 'share_of_residual': judged.finding.share,
        'certain': judged.certain,
        'rivals': [{'id': name, 'delta_bic': distance} for name, distance in judged.rivals],
    }


def _found(trace: Trace, estimates: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Describe the curve that has no name; None where there is none."""
    if trace.found is None:
        return None
    placed = trace.found.placed
    low, high, *added = estimates[-1].values()
    return {
        'id': placed.effect.id, 'port': placed.port.name, 'kind': placed.port.kind,
        'signal': placed.effect.reads[0], 'explained': False,
        'says': f'a free curve of the {over(placed)}',
        'p_value': trace.found.p_value, 'share_of_residual': trace.found.proof.relative,
        'between': [trace.found.proof.low, trace.found.proof.high],
        'units': {'knots': low['unit'], 'added': added[0]['unit']},
        'knots': np.linspace(low['value'], high['value'], len(added)).tolist(),
        'added': [a['value'] for a in added], 'std_errors': [a['std_error'] for a in added],
        'others': [{'port': other.port.name, 'signal': other.effect.reads[0],
                    'delta_bic': distance} for other, distance in trace.found.others],
    }


def _std_errors(fit: Fit) -> dict[str, float | None]:
    """Return standard errors by label, in the unit of each unknown."""
    known = fit.identifiability().std_error
    errors: dict[str, float | None] = {}
    for unknown in fit.unknowns:
        relative = known.get(label(unknown))
        errors[label(unknown)] = None if relative is None else relative * _unit_step(fit, unknown)
    return errors


def _unit_step(fit: Fit, unknown: Unknown) -> float:
    """Say what a step of one in the coordinate of an unknown means in its unit."""
    return abs(get(fit.candidate, unknown)) if unknown.log else unknown.scale


def effect_estimates(fit: Fit) -> list[dict[str, Any]]:
    """Give every effect's parameters with unit and standard error, refinements in use only."""
    errors = _std_errors(fit)
    return [{
        p.name: {'value': value, 'unit': placed.effect.unit(p, placed.port),
                 'std_error': errors.get(f'{index}:{p.name}')}
        for p, value in zip(placed.effect.parameters, placed.values, strict=True)
        if value not in (p.refinement, p.unreached)}
        for index, placed in enumerate(fit.candidate.effects)]


def parameters(fit: Fit) -> dict[str, Any]:
    """Give the plant's parameters with unit and standard error; None where not known alone."""
    errors = _std_errors(fit)
    units = {p.name: p.unit for p in fit.candidate.plant.parameters}
    together = {name for c in fit.candidate.plant.combinations for name in c}
    return {name: {'value': fit.candidate.values[name], 'unit': unit,
                   'std_error': None if name in together else errors.get(name)}
            for name, unit in units.items()}


def _series(trace: Trace) -> list[dict[str, Any]]:
    """Errors of each series; train and test stand side by side where both come from it."""
    train, test = (trace.recordings[name].series for name in ('train', 'test'))
    rows: list[dict[str, Any]] = [{'bag': series.source} for series in train]
    for name, fit in (('before', trace.before), ('after', trace.final)):
        predictor = Analytical(fit.candidate.model())
        for row in rows:
            row[name] = {'one_step': {}, 'free_run': {}}
        for mode in ('one_step', 'free_run'):
            for part, some in (('train', train), ('test', test)):
                if len(some) == len(train):
                    for row, error in zip(rows, errors_by_series(predictor, some, mode),
                                          strict=True):
                        row[name][mode][part] = rms(error)
    return [row for row in rows if all(
        np.isfinite(error) for when in ('before', 'after')
        for errors in row[when].values() for error in errors.values())]


def _short(value: float) -> str:
    return f'{value:.3g}'


def model_of(trace: Trace, fit: Fit, provenance: dict[str, Any]) -> Model:
    """Make the model file of one of a trace's fits, before or after."""
    candidate = fit.candidate
    errors = _std_errors(fit)
    scored = trace.errors['after' if fit is trace.final else 'before']
    together = {name for c in candidate.plant.combinations for name in c}
    known = {p.name: None if p.name in together else errors.get(p.name)
             for p in candidate.plant.parameters}
    return Model(
        plant=candidate.plant,
        parameters={name: Estimate(candidate.values[name], spread, spread is not None)
                    for name, spread in known.items()},
        constants={c.name: candidate.values[c.name] for c in candidate.plant.constants},
        sample_time=candidate.sample_time,
        effects=tuple(FittedEffect(placed, {p.name: errors.get(f'{index}:{p.name}')
                                            for p in placed.effect.parameters})
                      for index, placed in enumerate(candidate.effects)),
        timing=dict(candidate.timing or {}), substeps=candidate.substeps,
        errors=deepcopy({'before': trace.errors['before'], 'after': scored}),    # no YAML aliases
        provenance=provenance)
