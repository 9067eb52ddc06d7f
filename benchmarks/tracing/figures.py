"""The figures of a results file: what was named against what was there, as Markdown.

python -m benchmarks.tracing.figures out/tracing.jsonl
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import product
import json
from pathlib import Path
import sys
from typing import Any

import numpy as np

from benchmarks.tracing.cases import SEVERAL
from benchmarks.tracing.lacking import STATIC

Line = dict[str, Any]
ENOUGH = 0.8    # of what the true law would explain
# Effects of 'outside' that the library names.
HAS_A_NAME = {'resonance': 'mode', 'leak_drift': 'drift'}
SHOWS = 0.03    # an effect shows where the best linear fit's error is this far above the noise


def read(path: Path) -> list[Line]:
    """Return the lines of a results file; a last line cut short by an interrupt is left out."""
    if not path.exists():
        return []
    whole = [text for text in path.read_text().splitlines(keepends=True) if text.endswith('\n')]
    return [json.loads(text) for text in whole]


def named(line: Line) -> list[str]:
    """Return the ids of the effects that the tracer named, in its order."""
    return [effect['id'] for effect in line.get('report', {}).get('effects', [])]


def certain(line: Line) -> list[str]:
    """Return the ids that it called certain."""
    return [e['id'] for e in line.get('report', {}).get('effects', []) if e['certain']]


def outcome(line: Line) -> str:
    """Judge a trace: 'right', 'part' (of several), 'ambiguous', 'wrong', a verdict or 'failure'.

    right: the effect first, or all of several. For 'none', 'outside' and 'static' nothing is to be
    named, but for what of 'outside' the library has a name.
    ambiguous: another first, in a set from which, by the report, the right one cannot be
    distinguished.
    """
    if 'failure' in line:
        return 'failure'
    names, there = named(line), line['effects']
    verdict = str(line['report']['verdict'])
    if names and names == [HAS_A_NAME.get(effect) for effect in there]:
        return 'right'
    if line['kind'] in ('none', 'outside', 'static'):
        return 'wrong' if names else verdict
    if line['kind'] in SEVERAL:
        if set(there) <= set(names):
            return 'right'
        return 'part' if set(there) & set(names) else 'wrong' if names else verdict
    if names[:1] == list(there):
        return 'right'
    if any(there[0] in together for together in line['report']['ambiguous']):
        return 'ambiguous'
    return 'wrong' if names else verdict


def report(lines: Sequence[Line]) -> str:
    """Return the figures, the confusion matrix and the outcomes by kind, noise and excitation."""
    parts = ['| figure | reached | of |', '|---|---|---|', *_figures(lines), '']
    for kind in ('single', 'variant', *SEVERAL, 'outside', 'static', 'none'):
        of_kind = [line for line in lines if line['kind'] == kind]
        if not of_kind:
            continue
        for key in ('snr_db', 'excitation', 'effects'):
            if kind not in SEVERAL or key != 'effects':
                parts += [*_outcomes(kind, key, of_kind), '']
    seen = [x for x in lines if x['kind'] in ('single', 'variant') and x['shows'] >= SHOWS]
    parts += ['Effect there (row) against effect named first (column), where it shows:', '',
              *_confusion(seen)]
    return '\n'.join(parts)


def _figures(lines: Sequence[Line]) -> list[str]:
    def of(kind: str, snr: float | None = None, shown: bool = True) -> list[Line]:
        return [x for x in lines if x['kind'] == kind and (snr is None or x['snr_db'] == snr)
                and (not shown or x['shows'] >= SHOWS)]

    rows = []
    for kind in ('single', 'variant'):
        for snr in (46.0, 36.0, 26.0):
            some = of(kind, snr)
            rows.append(_share(f'{kind}, {snr:.0f} dB: right id first', some,
                               lambda x: outcome(x) == 'right'))
            rows.append(_share(f'{kind}, {snr:.0f} dB: wrong, not said to be ambiguous', some,
                               lambda x: outcome(x) == 'wrong'))
    for kind in ('single', 'variant'):
        right = [x for x in of(kind, 46.0) if outcome(x) == 'right']
        alone = [x for x in right if len(named(x)) == 1]
        rows.append(_share(f'{kind}, 46 dB, right: nothing else named', right,
                           lambda x: len(named(x)) == 1))
        rows.append(_share(f'{kind}, 46 dB, right and single: certain', alone,
                           lambda x: bool(certain(x))))
        rows.append(_share(f'{kind}, any noise: a wrong effect certain', of(kind, shown=False),
                           lambda x: bool(set(certain(x)) - set(x['effects']))))
    rows.append(_share('nothing added: an effect named', of('none', shown=False),
                       lambda x: bool(named(x))))
    outside = [x for x in of('outside', shown=False) if outcome(x) != 'right']
    rows.append(_share('outside: an effect certain', outside, lambda x: bool(certain(x))))
    rows.append(_share('outside: an effect named', outside, lambda x: bool(named(x))))
    for kind, snr in product(SEVERAL, (46.0, 36.0, 26.0)):
        each = [x for x in of(kind, snr) if min(x['shows_alone'].values()) >= SHOWS]
        rows.append(_share(f'{kind}, {snr:.0f} dB, each shows alone: all named', each,
                           lambda x: outcome(x) == 'right'))
        rows.append(_share(f'{kind}, {snr:.0f} dB, each shows alone: another named', each,
                           lambda x: bool(set(named(x)) - set(x['effects']))))
        visible = [x for x in of(kind, snr) if min(x['shows_beside'].values()) >= SHOWS]
        rows.append(_share(f'{kind}, {snr:.0f} dB, each shows beside the others: all named',
                           visible, lambda x: outcome(x) == 'right'))
    for kind in ('single', *SEVERAL):
        ratios = [x['report']['after']['free_run']['test'] / x['true_error']
                  for x in of(kind) if outcome(x) == 'right' and x['true_error']]
        rows.append(_share(f"{kind}, right: test error within 10 % of the true structure's",
                           ratios, lambda ratio: ratio <= 1.1))
    rows += _static([x for x in lines if x['kind'] == 'static' and x['shows'] >= SHOWS])
    if lines:
        seconds = [x['seconds'] for x in lines]
        rows.append(f'| seconds a trace, median (largest) | {np.median(seconds):.1f}'
                    f' ({max(seconds):.1f}) | {len(seconds)} |')
    return rows


def _static(lines: Sequence[Line]) -> list[str]:
    """Count the curves that stand for a law outside the library; nothing where none was run."""
    if not lines:
        return []
    seen = [x for x in lines if x.get('report', {}).get('found')]
    return [
        _share('static: a curve found', lines, lambda x: x in seen),
        _share('static: port and signal of the curve right', lines,
               lambda x: x in seen and placed_right(x)),
        _share('static: where a curve was found, port and signal right', seen, placed_right),
        _share('static: at least 80 % explained of what the true law would', lines,
               lambda x: explained(x) >= ENOUGH),
        _share('static: an effect named, none of them certain', lines,
               lambda x: bool(named(x)) and not certain(x)),
        _share('static: an effect certain', lines, lambda x: bool(certain(x)))]


def placed_right(line: Line) -> bool:
    """Whether the curve found is at a port and over a signal that show the law built in."""
    found = line['report']['found']
    return (found['kind'], found['signal']) in STATIC[line['effects'][0]]


def explained(line: Line) -> float:
    """Share of the test part's error that is explained, over that above the noise."""
    if 'failure' in line:
        return 0.0
    before, after = (line['report'][when]['free_run']['test'] ** 2 for when in ('before', 'after'))
    return float((before - after) / (before - line['truth']['noise_rms'] ** 2))


def _share[T](title: str, some: Sequence[T], is_so: Callable[[T], bool]) -> str:
    count = sum(map(is_so, some))
    reached = f'{100 * count / len(some):.1f} % ({count})' if some else 'none run'
    return f'| {title} | {reached} | {len(some)} |'


def _outcomes(kind: str, key: str, lines: Iterable[Line]) -> list[str]:
    counts: dict[str, Counter[str]] = {}
    for line in lines:
        value = ' '.join(line[key]) if key == 'effects' else str(line[key])
        what = outcome(line)
        if kind in ('single', 'variant', *SEVERAL) and line['shows'] < SHOWS:
            what = f'hidden: {what}'
        counts.setdefault(value, Counter())[what] += 1
    return _table(f'{kind} by {key}', counts)


def _confusion(lines: Iterable[Line]) -> list[str]:
    counts: dict[str, Counter[str]] = {}
    for line in lines:
        first = named(line)[0] if named(line) else outcome(line)
        counts.setdefault(line['effects'][0], Counter())[first] += 1
    return _table('', counts)


def _table(title: str, counts: dict[str, Counter[str]]) -> list[str]:
    columns = sorted({column for row in counts.values() for column in row})
    return [f'| {title} | ' + ' | '.join(columns) + ' |', '|---' * (len(columns) + 1) + '|',
            *(f'| {name} | ' + ' | '.join(str(row[c] or '') for c in columns) + ' |'
              for name, row in sorted(counts.items()))]


if __name__ == '__main__':
    print(report(read(Path(sys.argv[1]))))
