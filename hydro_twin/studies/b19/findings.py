"""The findings of [B19], judged by the figures here."""
from __future__ import annotations

from hydro_twin.studies.b19.blocks import (
    compared,
    equal,
    LEVEL,
    medians,
    OPTIMISERS,
    Results,
)
from hydro_twin.studies.b19.layout import median, number, p_value, table
from hydro_twin.studies.b19.study import PARTS


def _verdict(holds: bool, otherwise: str = 'Does not reappear') -> str:
    return '**Reappears**' if holds else f'**{otherwise}**'


def findings(results: Results) -> str:
    """Judge the paper's findings by the figures here."""
    study = results['published']
    train, test_part = (medians(study['runs'], part) for part in PARTS)
    best = min(test_part[m] for m in OPTIMISERS)
    ratios = [best / median(results['chosen'][kind]['test']['one_step'])
              for kind in ('mlp', 'hybrid')]
    worst_p = max(compared(results, m, n) for m in OPTIMISERS for n in ('mlp', 'hybrid'))
    close = {part: max(found[m] for m in ('ea', 'bees', 'pso'))
             / min(found[m] for m in ('ea', 'bees', 'pso')) - 1
             for part, found in (('train', train), ('test', test_part))}
    behind = test_part['random'] / max(test_part[m] for m in ('ea', 'bees', 'pso')) - 1
    p_pso = compared(results, 'pso', 'bees')
    burst = {m: 100 * (train[m] / test_part[m] - 1) for m in ('pso', 'mlp', 'hybrid')}
    p_equal = compared(results, 'mlp', 'hybrid', step='chosen')
    gain = train['pso'] - study['runs']['least_squares']['train']['one_step'][0]
    difference = 100 * (test_part['bees'] / test_part['pso'] - 1)
    found = {
        'The networks are about 3.5 times better than the best linear model':
            f'{_verdict(min(ratios) > 2)}: {ratios[0]:.1f} times (MLP), {ratios[1]:.1f} times '
            f'(hybrid), with settings chosen on validation data; p = {p_value(worst_p)} at most '
            'for any network against any linear model.',
        'The linear model lacks effects, not tuning':
            '**Half**: the optimisers have nothing left to find in their box; least squares ends '
            f'{gain:.4f} below the median of PSO in training. But most of what 14 free '
            'coefficients, as linear as the model, gain over it is the box itself (see below).',
        'EA, BA and PSO are equal in practice, random search is worse':
            f'{_verdict(behind > 0.02 > close["test"])}: within {100 * close["train"]:.1f} % of '
            f'each other in training and {100 * close["test"]:.1f} % in test, random search '
            f'{100 * behind:.0f} % behind.',
        'BA is significantly better than PSO in test (p = 4e-4)':
            f'{_verdict(difference < 0 and p_pso < LEVEL, "Reversed")}: PSO '
            f'{number(test_part["pso"])}, BA {number(test_part["bees"])}, '
            f'p = {p_value(p_pso)}. The difference is {abs(difference):.1f} %.',
        'Linear models do worse in training than in test, because of the burst; networks do not':
            f'{_verdict(burst["pso"] > 5 > burst["mlp"])}, weaker: PSO is {burst["pso"]:.0f} % '
            f'worse in training (71 % in the paper), MLP {burst["mlp"]:+.0f} %, hybrid '
            f'{burst["hybrid"]:+.0f} %.',
        'MLP and hybrid are equal (p = 0.48)':
            f'{_verdict(p_equal > LEVEL, "Depends on the structure")}. {equal(results)}',
    }
    return table(['finding of [B19]', 'here'], found.items())
