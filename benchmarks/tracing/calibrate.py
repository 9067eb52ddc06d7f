"""Are the probabilities of a report right? Stated against counted, over files of results.

python -m benchmarks.tracing.calibrate out/tracing.jsonl out/servos.jsonl out/machines.jsonl
python -m benchmarks.tracing.calibrate out/held_out.jsonl --picture docs/img/reliability.png

The first, over development rigs, gives the shares in hydro_twin/inference/probability.py.
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.tracing.figures import HAS_A_NAME, Line, named, read, SHOWS

# Edges of the groups of stated probabilities: the last one is what a report calls certain.
EDGES = (0.0, 0.25, 0.5, 0.7, 0.8, 0.9, 0.99, 1.0)


@dataclass(frozen=True)
class Statement:
    """Something that a report gives a probability of.

    Attributes:
        what: 'effect', 'nothing' or 'law_unknown'.
        stated: its probability.
        true: whether it is so.
    """

    what: str
    stated: float
    true: bool


@dataclass(frozen=True)
class Group:
    """Statements of about one probability.

    Attributes:
        low, high: between which it is.
        count: how many.
        stated: their mean probability.
        true: share of them that is so.
    """

    low: float
    high: float
    count: int
    stated: float
    true: float


def there(line: Line) -> set[str]:
    """Return the ids of what a rig lacks and the library has."""
    if line['kind'] in ('outside', 'static'):
        return {HAS_A_NAME[name] for name in line['effects'] if name in HAS_A_NAME}
    return set(line['effects'])


def statements(lines: Sequence[Line]) -> list[Statement]:
    """List what the reports state, but for effects of which it is open whether they are there."""
    found = []
    for line in lines:
        if 'failure' in line:
            continue
        report, known = line['report'], there(line)
        also = set(line.get('also', ()))
        names = set(named(line)) - also
        found += [Statement('effect', effect['probability'], effect['id'] in known)
                  for effect in report['effects'] if effect['id'] not in also]
        nothing = line['kind'] == 'none' or line.get('shows', SHOWS) < SHOWS
        if not names:
            found.append(Statement('nothing', report['nothing'], nothing))
        unknown = not nothing if not names else not names & known
        found.append(Statement('law_unknown', report['law_unknown'], unknown))
    return found


def groups(some: Sequence[Statement]) -> list[Group]:
    """Group statements by their probability."""
    index = np.digitize([one.stated for one in some], EDGES[1:-1])
    found = []
    for k, (low, high) in enumerate(pairwise(EDGES)):
        here = [one for one, at in zip(some, index, strict=True) if at == k]
        if here:
            found.append(Group(low, high, len(here), float(np.mean([one.stated for one in here])),
                               float(np.mean([one.true for one in here]))))
    return found


def calibration_error(some: Sequence[Statement]) -> float:
    """Return the expected calibration error: |stated - true|, averaged over the statements."""
    return sum(group.count * abs(group.stated - group.true) for group in groups(some)) / len(some)


def report(lines: Sequence[Line]) -> str:
    """Return the tables, as Markdown."""
    some = statements(lines)
    effects = [one for one in some if one.what == 'effect']
    rows = ['| an effect, stated | mean stated | right | of |', '|---|---|---|---|']
    rows += [f'| {group.low:g} to {group.high:g} | {group.stated:.3f} | {group.true:.3f} '
             f'| {group.count} |' for group in groups(effects)]
    if effects:
        error, of_all = calibration_error(effects), calibration_error(some)
        rows += ['', f'Expected calibration error, effects: {error:.3f}; all: {of_all:.3f}', '']
    rows += ['| stated | so it was | of |', '|---|---|---|']
    for what in ('nothing', 'law_unknown'):
        for stated in sorted({round(one.stated, 3) for one in some if one.what == what}):
            here = [one.true for one in some
                    if one.what == what and round(one.stated, 3) == stated]
            rows.append(f'| {what.replace("_", " ")} {stated:.3f} | {np.mean(here):.3f} '
                        f'| {len(here)} |')
    return '\n'.join(rows)


def draw(lines: Sequence[Line], path: Path) -> None:
    """Draw the reliability diagram of the effects named."""
    found = groups([one for one in statements(lines) if one.what == 'effect'])
    figure, axes = plt.subplots(figsize=(4.0, 4.0), layout='constrained')
    axes.plot([0, 1], [0, 1], color='0.7', lw=1)
    errors = [np.sqrt(max(g.true * (1 - g.true), 0.25 / g.count) / g.count) for g in found]
    axes.errorbar([g.stated for g in found], [g.true for g in found], errors, fmt='o', capsize=3)
    for g in found:
        axes.annotate(f'{g.count}', (g.stated, g.true), (6, -10), textcoords='offset points')
    axes.set(xlabel='stated probability of an effect', ylabel='share that was right',
             xlim=(0, 1.03), ylim=(0, 1.05))
    figure.savefig(path, dpi=150)


def main() -> None:
    """Print the tables of all files together."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('files', nargs='+', type=Path)
    parser.add_argument('--picture', type=Path)
    asked = parser.parse_args()
    lines = [line for path in asked.files for line in read(path)]
    print(report(lines))
    if asked.picture:
        draw(lines, asked.picture)


if __name__ == '__main__':
    main()
