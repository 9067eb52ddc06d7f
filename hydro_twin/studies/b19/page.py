"""The page on [B19]: puts results, figures and the blocks with figures in their places."""
from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
import re
from typing import Any

from matplotlib.figure import Figure

from hydro_twin.errors import UserError
from hydro_twin.files import write_whole
from hydro_twin.studies.b19 import blocks as b
from hydro_twin.studies.b19.comparison import svg
from hydro_twin.studies.b19.findings import findings
from hydro_twin.studies.b19.reproduce import EPOCHS_DRAWN
from hydro_twin.studies.b19.study import PARTS, TITLES

BLOCK = re.compile(r'<!-- ([\w-]+) -->\n(?:(?!<!-- ).*\n)*<!-- end -->')
NETWORKS = ('mlp', 'hybrid')


def write_page(results: Mapping[str, Any], folder: Path) -> None:
    """Write load_simulator.json, the figures, and the blocks of docs/load_simulator.md.

    Raises:
        UserError: the page has not the blocks that it should have.
    """
    page = folder / 'load_simulator.md'
    text = filled(page.read_text(encoding='utf-8'), blocks(results))
    write_whole(folder / 'load_simulator.json', json.dumps(results) + '\n')
    (folder / 'img').mkdir(exist_ok=True)
    for name, drawing in (('learning', learning(results)), ('boxes', boxes(results))):
        write_whole(folder / 'img' / f'load_simulator_{name}.svg', drawing)
    write_whole(page, text)


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Write every block of the page that holds figures, by its name."""
    made = {
        'one-step': b.one_step(results),
        'five-numbers': b.summaries(results),
        'p-train': b.p_values(results, 'train'),
        'p-test': b.p_values(results, 'test'),
        'decay-mlp': b.decays(results, 'mlp'),
        'decay-hybrid': b.decays(results, 'hybrid'),
        'structure-mlp': b.structures(results, 'mlp'),
        'structure-hybrid': b.structures(results, 'hybrid'),
        'chosen': b.chosen(results),
        'validation': b.validation(results),
        'equal': b.equal(results),
        'box': b.box(results),
        'box-share': b.box_share(results),
        'alignment': b.alignment(results),
        'optimisers': b.choices(results['optimisers']),
        'networks': b.choices(results['networks']),
        'range': b.share_of_range(results),
        'swapped': b.swapped(results),
        'drop': b.drop(results),
        'free-run': b.free_run(results),
        'free-fit': b.free_fit(results),
        'runaway': b.runaway(results),
        'gain': b.gain(results),
        'nine': b.nine(results),
        'mild': b.mild(results),
        'findings': findings(results),
        'frequencies': b.frequencies(results),
    }
    if results['measured']:
        made['measured'] = b.measured(results)
    return made


def filled(text: str, made: Mapping[str, str]) -> str:
    """Replace each block of a page, between <!-- name --> and <!-- end -->.

    Raises:
        UserError: a block is missing, or unknown.
    """
    names = [match[1] for match in BLOCK.finditer(text)]
    if sorted(names) != sorted(made):
        raise UserError(f'the page should have each of the blocks {", ".join(sorted(made))} '
                        f'once; it has {", ".join(sorted(names))}')
    return BLOCK.sub(lambda match: f'<!-- {match[1]} -->\n{made[match[1]]}\n<!-- end -->', text)


def learning(results: Mapping[str, Any]) -> str:
    """Draw [B19] Fig. 2: the networks' test error, mean of the runs, and the best of the BA."""
    figure = Figure(figsize=(7, 4), layout='constrained')
    axes = figure.subplots()
    runs = results['published']['runs']
    for step, style, label in (('published', '-', 'settings of the paper'),
                               ('chosen', '--', 'settings chosen here')):
        for k, kind in enumerate(NETWORKS):
            found = runs[kind] if step == 'published' else results[step][kind]
            axes.plot(EPOCHS_DRAWN + 1, found['test_curve'], style, color=f'C{k}',
                      label=f'{TITLES[kind]}, {label}')
    axes.axhline(min(runs['bees']['test']['one_step']), color='black', linestyle=':',
                 label='best of the BA')
    axes.set(xlabel='epoch', ylabel='RMS in test, mean [N m]', xscale='log', yscale='log')
    axes.legend(fontsize='small')
    return svg(figure, 'learning')


def boxes(results: Mapping[str, Any]) -> str:
    """Draw [B19] Fig. 3: the spread of the networks' errors in training and test."""
    figure = Figure(figsize=(7, 4), layout='constrained')
    pair = figure.subplots(1, 2, sharey=True)
    runs = results['published']['runs']
    for axes, part in zip(pair, PARTS, strict=True):
        errors = [runs[kind][part]['one_step'] for kind in NETWORKS]
        errors += [results['chosen'][kind][part]['one_step'] for kind in NETWORKS]
        axes.boxplot(errors, whis=(0, 100))
        axes.set_xticks(range(1, 5), [f'{TITLES[kind]}\n{who}' for who in ('paper', 'chosen')
                                      for kind in NETWORKS])
        axes.set_title(part)
    pair[0].set_ylabel('RMS, one step [N m]')
    return svg(figure, 'boxes')
