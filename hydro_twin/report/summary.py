"""The result of a trace as one plain object: `report.json`."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hydro_twin.effects import Course, Placed
from hydro_twin.model import Model
from hydro_twin.plants import Port
from hydro_twin.result import (
    BestNamed,
    FoundCurve,
    Memory,
    NamedEffect,
    Remainder,
    TestPart,
    TIME,
    TraceResult,
)

EVEN = 0.5              # probability from which a statement is more likely right than wrong
SETTLED = 3.0           # time constants, in which 95 % of a change are made
COUNTED = 1000.0        # times the noise, beyond which a sentence gives no number: the noise of a
#                         coarse encoder is almost nothing while it stands still
DIFFERS = 'which was not fitted; the first third of each differs from the rest'
TESTED: Mapping[TestPart, str] = {
    'recordings': 'bags that were not fitted',
    'third': 'the first third of every series, which was not fitted',
    'sixth': 'the second sixth of every series, which was not fitted; the first was, since more '
             'happens in the first third than in the rest',
    'series': f'every third series, whole, {DIFFERS}',
    'windows': f'every third window of at most 10 s, {DIFFERS}',
}


def summarise(result: TraceResult) -> dict[str, Any]:
    """Lay out a result as the object of `report.json`; errors are RMS in the output's unit."""
    estimates = effect_estimates(result.after)
    remainder = result.remainder
    share, p_value = remainder.by_ports
    return {
        'plant': result.plant.name,
        'verdict': result.verdict,
        'says': sentence(result),
        'nothing': result.nothing,
        'law_unknown': result.law_unknown,
        'evidence_left': result.evidence_left,
        'tested': TESTED[result.tested],
        'effects': [_effect(effect, estimates[effect.index], result.after)
                    for effect in result.effects],
        'found': result.curve and _found(result.curve, estimates[-1]),
        'best_named': result.best_named and _best_named(result.best_named),
        'ambiguous': [list(group) for group in result.ambiguous],
        'horizon_s': result.horizon,
        'interpolation': result.after.interpolation,
        'before': result.before.errors['after'],
        'after': result.after.errors['after'],
        'improvement': {'relative': result.improvement.relative, 'low': result.improvement.low,
                        'high': result.improvement.high},
        'cannot_show': [] if result.fails else [
            {'id': h.id, 'port': h.port, 'says': h.says} for h in result.undetectable],
        'outputs': {name: {'unit': one.unit, 'before': dict(one.before),
                           'after': dict(one.after), 'noise': one.noise}
                    for name, one in result.outputs.items()},
        'series': [{'bag': row.bag, 'before': row.before, 'after': row.after}
                   for row in result.series],
        'parameters': {'before': parameters(result.before), 'after': parameters(result.after)},
        'persistence': {'test': result.persistence},
        'noise_floor': result.noise,
        'memory': result.memory and _memory(result.memory, result.plant.output.unit),
        'remainder': {
            'white': remainder.white,
            'lines_hz': [line.frequency for line in remainder.lines],
            'depends_on': [{'port': d.port.name, 'signal': d.signal, 'share': d.share,
                            'p_value': d.p_value} for d in remainder.depends_on],
            'when': [{'bag': burst.bag, 'from_s': burst.begin, 'to_s': burst.end}
                     for burst in remainder.bursts],
            'drifts': remainder.drifts,
            'predicted_by_ports': {'share': share, 'p_value': p_value},
            'says': remainder_sentence(result),
        },
    }


def sentence(result: TraceResult) -> str:
    """Say the verdict to a person, in one sentence."""
    unit = '' if result.plant.output.unit == '1' else f' {result.plant.output.unit}'
    test = [model.errors['after'][result.judged]['test']
            for model in (result.before, result.after)]
    error = 'free-run error' if result.horizon is None else (
        f'error over {_short(result.horizon)} s')
    falls = (f'the {error} on data it was not fitted to falls from {_short(test[0])} to '
             f'{_short(test[1])}{unit}')
    if result.verdict == 'nothing_missing':
        model = 'model it started from' if result.before.effects else 'linear model'
        leaves = (f'the {model} leaves {_short(test[0])}{unit} on data it was not fitted to, '
                  f'and no effect earns its place there')
        if result.nothing > EVEN:
            return f'Nothing is missing: {leaves}.'
        return (f'Nothing is found: {leaves}. That is more than white noise, so either the noise '
                f'has memory or something acts that the ports do not show.')
    if result.verdict == 'unexplained':
        left = ('The residual has structure that no known effect explains: '
                f'{remainder_sentence(result)}')
        if result.curve is None:
            return f'{left}.'
        nearest = '' if result.best_named is None else (
            '. The best named explanation, ' + _listed([
                _with_article(placed, (placed.port.name,))
                for placed in result.best_named.effects])
            + ', explains less')
        return (f'{left}. With a free curve of the {_over_curve(result.curve.placed)}, which '
                f'has no name, {falls}{nearest}.')
    it = 'it' if len(result.effects) == 1 and result.curve is None else 'them'
    return f'The model lacks {_lacks(result)}: with {it}, {falls}.'


def _lacks(result: TraceResult) -> str:
    """Name what was found: first what is certain, then what is likely, then what is unlikely."""
    certain: list[str] = []
    likely: list[str] = []
    unlikely: list[str] = []
    for effect in result.effects:
        among = certain if effect.certain else unlikely if effect.law_unknown > EVEN else likely
        among.append(_named(effect, result.after))
    groups = [_listed(certain)] if certain else []
    if likely:
        begin = 'something that behaves' if len(likely) == 1 else 'effects that behave'
        groups.append(f'{begin} like {_listed(likely)}')
    if unlikely:
        begin = 'something unexplained' if len(unlikely) == 1 else 'unexplained effects'
        groups.append(f'{begin}, most like {_listed(unlikely)}')
    if result.curve:
        groups.append('something that no known effect explains, a free curve of the '
                      f'{_over_curve(result.curve.placed)}')
    return ', and '.join(groups)


def _listed(items: Sequence[str]) -> str:
    """List items, as in 'a, b and c'."""
    *first, last = items
    return f'{", ".join(first)} and {last}' if first else last


def over(port: Port, signal: str) -> str:
    """Say over what a curve is, and where."""
    return f'{meaning(port, signal)} at the {port.name}'


def meaning(port: Port, signal: str) -> str:
    """Say what a signal at a port is."""
    return port.meaning if signal == 'value' else signal.replace('_', ' ')


def _over_curve(placed: Placed) -> str:
    return over(placed.port, placed.effect.reads[0])


def where(placed: Placed, ports: Sequence[str]) -> str:
    """Name an effect with the ports at which it may sit, or the parameters that may drift."""
    name = placed.effect.id.replace('_', ' ')
    if placed.effect.course is not None:
        return f'{name} of {" or ".join(ports)}'
    return f'{name} at the {" or the ".join(ports)}'


def _named(effect: NamedEffect, model: Model) -> str:
    text = _with_article(effect.placed, (effect.port, *effect.other_ports))
    if effect.placed.effect.course is not None:
        text += f' ({_changes(effect.placed, effect.placed.effect.course, model)})'
    if effect.close:
        text = f'{text} (or {" or ".join(name.replace("_", " ") for name in effect.close)})'
    return text


def _with_article(placed: Placed, ports: Sequence[str]) -> str:
    """Name an effect with its ports, after 'a' or 'an' if it can be counted."""
    text = where(placed, ports)
    if not placed.effect.countable:
        return text
    return f'{"an" if text[0] in "aeiou" else "a"} {text}'


def _changes(placed: Placed, course: Course, model: Model) -> str:
    """Say from what to what a parameter drifts, and when."""
    since, end = course.interval(placed.values)
    last = model.values[placed.port.name]
    first = last * float(course.factor(placed.values, since))
    idle, settled = placed.named['idle'], SETTLED * placed.named['time_constant']
    after = f'from {_short(idle)} s on, ' if idle else ''
    return (f'{after}from {_short(first)} to {_short(last)} {placed.port.unit} in '
            f'{_short(min(end - since, settled))} s')


def remainder_sentence(result: TraceResult) -> str:
    """Say what can be said of the residual at the end."""
    left = result.remainder
    parts = [*_lines(left), *_dependence(left), *_bursts(left)]
    if left.drifts:
        parts.append('a parameter drifts over the recording')
    if left.held_out_ratio is not None:
        parts.append(f'on data that was not fitted the error is {left.held_out_ratio:.1f} times '
                     'as large: something happens there that does not in the data that was')
    ratio = left.error / max(result.noise, 1e-300)
    how_much = f'{ratio:.0f}' if ratio < COUNTED else f'more than {COUNTED:.0f}'
    if not parts and left.exceeds_any_noise:
        much = '' if result.fails else f' and is {how_much} times as large as the noise'
        parts.append('what is left depends on nothing that can be seen at the ports' + much)
    if result.fails:
        parts.insert(0, f'the model does not fit, by {how_much} times the noise, so that nothing '
                        'can be said of other effects')
    if not parts and left.structured:
        parts.append(f'{left.by_ports[0]:.0%} of what is left follows what happens at the ports, '
                     f'by no single curve')
    if parts:
        return '; '.join(parts)
    if left.white:
        return 'nothing left above the noise'
    return 'the residual is coloured, but independent of the signals of the plant'


def _lines(left: Remainder) -> list[str]:
    hertz = [f'{line.frequency:.3g}' for line in left.lines]
    if len(hertz) == 1:
        return [f'a spectral line at {hertz[0]} Hz']
    return [f'spectral lines at {", ".join(hertz)} Hz'] if hertz else []


def _dependence(left: Remainder) -> list[str]:
    if not left.depends_on:
        return []
    first = left.depends_on[0]
    if first.signal == TIME:
        much = f'{first.share:.0%} of what is left'
        return [f'its mean moves with time ({much}), as if a load or the zero of a sensor moved']
    what = over(first.port, first.signal)
    return [f'it depends on the {what} ({first.share:.0%} of what is left)']


def _bursts(left: Remainder) -> list[str]:
    bursts = left.bursts
    if not bursts:
        return []
    when = (f'from {bursts[0].begin:.1f} to {bursts[0].end:.1f} s' if len(bursts) == 1 else
            f'in {len(bursts)} bursts, the first at {bursts[0].begin:.1f} s')
    bag = f' of {bursts[0].bag}' if bursts[0].bag else ''
    seconds = sum(burst.end - burst.begin for burst in bursts)
    return [f'much of it is concentrated in {seconds:.1f} s, {when}{bag}']


def _effect(effect: NamedEffect, estimates: dict[str, Any], model: Model) -> dict[str, Any]:
    return {
        'id': effect.id, 'port': effect.port, 'or_ports': list(effect.other_ports),
        'parameters': estimates,
        'p_value': effect.p_value, 'share_of_residual': effect.share,
        'certain': effect.certain,
        'probability': effect.probability, 'ports': dict(effect.ports),
        'rivals': [{'id': name, 'delta_bic': distance} for name, distance in effect.rivals],
        'given': {name: {held: model.values[held] for held in together}
                  for name, together in effect.given.items()},
    }


def _memory(memory: Memory, unit: str) -> dict[str, Any]:
    moved = ', '.join(memory.moved) or 'no parameter'
    kept = (f'{moved} moved beyond the errors, and the rest is from all recordings'
            if memory.used else
            'what they say of the parameters does not go with the new recording, and was left out')
    after = '' if unit == '1' else f' {unit}'
    return {'bags': list(memory.bags), 'used': memory.used, 'moved': list(memory.moved),
            'held_out': {'before': memory.before, 'after': memory.after},
            'says': f'{kept}; on the earlier ones the error is {_short(memory.after)}{after}, and '
                    f'was {_short(memory.before)}{after}'}


def _best_named(named: BestNamed) -> dict[str, Any]:
    return {'effects': [{'id': placed.effect.id, 'port': placed.port.name,
                         'parameters': _values(placed)} for placed in named.effects],
            'held_out_error': named.held_out_error}


def _values(placed: Placed) -> dict[str, Any]:
    """Give an effect's parameters with unit, refinements in use only."""
    return {p.name: {'value': value, 'unit': placed.effect.unit(p, placed.port)}
            for p, value in placed.in_use}


def _found(found: FoundCurve, estimates: dict[str, Any]) -> dict[str, Any]:
    """Describe the curve that has no name."""
    placed = found.placed
    low, high, *added = estimates.values()
    return {
        'id': placed.effect.id, 'port': placed.port.name, 'kind': placed.port.kind,
        'signal': placed.effect.reads[0], 'explained': False,
        'says': f'a free curve of the {_over_curve(placed)}',
        'p_value': found.p_value, 'share_of_residual': found.improvement.relative,
        'between': [found.improvement.low, found.improvement.high],
        'units': {'knots': low['unit'], 'added': added[0]['unit']},
        'knots': np.linspace(low['value'], high['value'], len(added)).tolist(),
        'added': [a['value'] for a in added], 'std_errors': [a['std_error'] for a in added],
        'others': [{'port': other.port.name, 'signal': other.effect.reads[0],
                    'delta_bic': distance} for other, distance in found.others],
    }


def effect_estimates(model: Model) -> list[dict[str, Any]]:
    """Give every effect's parameters with unit and standard error, refinements in use only."""
    return [{name: {**value, 'std_error': model.record.std_error(k, name)}
             for name, value in _values(placed).items()} for k, placed in enumerate(model.effects)]


def parameters(model: Model) -> dict[str, Any]:
    """Give the plant's parameters with unit and standard error; None where not known by itself."""
    units = {p.name: p.unit for p in model.plant.parameters}
    return {name: {'value': p.value, 'unit': units[name], 'std_error': p.std_error}
            for name, p in model.parameters.items()}


def _short(value: float) -> str:
    return f'{value:.3g}'
