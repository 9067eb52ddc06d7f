"""The page of a trace, for a person: one file that needs no other."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from hydro_twin.model import Estimate
from hydro_twin.plants.combinations import product_of_powers
from hydro_twin.report.chart import AFTER, BEFORE, Illustration, plain
from hydro_twin.report.summary import where
from hydro_twin.result import AMBIGUOUS_DELTA_BIC, NEAR_DELTA_BIC, TraceResult

NOT_KNOWN = '–'


def page(result: TraceResult, summary: Mapping[str, Any], provenance: Mapping[str, Any],
         illustrations: Sequence[Illustration]) -> str:
    """Write the report as one self-contained page.

    Args:
        result: what was found.
        summary: the report object.
        provenance: bags with their SHA-256, command, seed and version.
        illustrations: the figures.
    """
    unit = result.plant.output.unit
    pages = environment()
    pages.filters |= {'short': short, 'spread': spread, 'percent': percent, 'shift': shift,
                      'p': probability,
                      'sentence': lambda text: text[:1].upper() + text[1:]}
    series_parts = [part for part in ('train', 'test')
                    if all(part in row['before']['free_run'] for row in summary['series'])]
    return pages.get_template('trace_page.html').render(
        plant=result.plant, unit='' if unit == '1' else unit, named=bool(result.effects),
        changed=result.changed, judged=result.judged, fails=result.fails,
        summary={**summary, 'effects': _effects(result, summary)},
        outputs=list(summary['outputs'].items())[1:],
        parameters=parameter_rows(result, summary['parameters']),
        provenance=provenance, illustrations=illustrations, series_parts=series_parts,
        found_figure=next((i.name for i in illustrations if i.name.startswith('found_')), ''),
        parts='parts fitted: {}, held out to test: {}'.format(*result.parts),
        colours={'before': BEFORE, 'after': AFTER}, close=AMBIGUOUS_DELTA_BIC, near=NEAR_DELTA_BIC,
        data={item.name: plain(item) for item in illustrations})


@cache
def environment(*folders: str) -> Environment:
    """Set up the templates of this folder once, for pages that hold their data as JSON.

    Args:
        folders: others of the package with templates, looked into first.
    """
    loaders = [PackageLoader('hydro_twin', folder) for folder in (*folders, 'report')]
    pages = Environment(loader=ChoiceLoader(loaders), autoescape=True,
                        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    pages.policies['json.dumps_kwargs'] = {'separators': (',', ':'), 'allow_nan': False}
    return pages


def short(value: float | None) -> str:
    """Write a number with four digits."""
    return NOT_KNOWN if value is None else f'{value:.4g}'


def spread(value: float | None) -> str:
    """Write a standard error."""
    return NOT_KNOWN if value is None else f'{value:.2g}'


def probability(value: float) -> str:
    """Write a p-value or a probability."""
    return '< 1e-99' if value < 1e-99 else f'{value:.2g}' if value < 0.1 else short(value)


def percent(share: float | None) -> str:
    """Write a share as percentage."""
    return NOT_KNOWN if share is None else f'{100.0 * share:.3g} %'


def shift(share: float | None) -> str:
    """Write by how much something is larger or smaller."""
    return NOT_KNOWN if share is None else f'{100.0 * share:+.3g} %'


def _effects(result: TraceResult, summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Add to each effect of the report what the page says beside."""
    rows = []
    for named, effect in zip(result.effects, summary['effects'], strict=True):
        law = named.placed.effect
        at = where(named.placed, (named.port, *named.other_ports))
        rows.append({**effect, 'where': at[0].upper() + at[1:],
                     'meanings': {p.name: p.meaning for p in law.parameters},
                     'figure': f'effect_{named.id}_{named.port}'})
    return rows


def parameter_rows(result: TraceResult, parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Lay out the parameters before and after, then the combinations that act only together."""
    plant = result.plant
    known = {p.name: (parameters['before'][p.name], parameters['after'][p.name])
             for p in plant.parameters}
    together = {name for combination in plant.combinations for name in combination}
    rows = [_row(p.name, p.meaning, p.unit, *known[p.name]) for p in plant.parameters]
    rows = [{**row, 'shift': None} if row['name'] in together else row for row in rows]
    for combination, before, after in zip(plant.combinations, result.combinations['before'],
                                          result.combinations['after'], strict=True):
        units = [(known[name][0]['unit'], power) for name, power in combination.items()]
        rows.append(_row(
            product_of_powers(combination.items(), ' ', ' / '), 'known only together',
            product_of_powers(units, ' ', ' / '),
            _plain(before), _plain(after)))
    return rows


def _row(name: str, meaning: str, unit: str, before: Mapping[str, Any], after: Mapping[str, Any]
         ) -> dict[str, Any]:
    moved, error = before['value'] - after['value'], before['std_error']
    return {'name': name, 'meaning': meaning, 'unit': unit, 'before': before, 'after': after,
            'shift': moved / after['value'], 'over_error': moved / error if error else None}


def _plain(estimate: Estimate) -> dict[str, float | None]:
    return {'value': estimate.value, 'std_error': estimate.std_error}
