"""The tables and the sentences with figures of the page on [B19], from the stored results."""
from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hydro_twin.studies.b19.layout import array, median, number, p_value, small, table
from hydro_twin.studies.b19.study import five_numbers, mann_whitney, PARTS, TITLES

LEVEL = 0.05            # of the Mann-Whitney test
SPAN = 300.0            # the output's range, |T_g| <= 150 N m
OPTIMISERS = ('random', 'ea', 'bees', 'pso')
METHODS = (*OPTIMISERS, 'mlp', 'hybrid')
# [B19] Tables 4 and 5: median in training; least, median and largest in test.
PUBLISHED = {
    'train, median': (9.68556, 9.30649, 9.346555, 9.30119, 1.45774, 1.482695),
    'test, least': (5.44198, 5.41832, 5.3362, 5.44812, 1.27542, 1.26246),
    'test, median': (5.573365, 5.44923, 5.38558, 5.44812, 1.50684, 1.48187),
    'test, largest': (6.26452, 5.52698, 5.55534, 5.52491, 1.62572, 1.89453)}
# [B19] Tables 6 and 7: p-values of the pairs that are not 6.3e-8.
PUBLISHED_P = {
    'train': {('ea', 'pso'): 5.35e-4, ('mlp', 'hybrid'): 0.213},
    'test': {('ea', 'bees'): 2.34e-4, ('ea', 'pso'): 0.588, ('bees', 'pso'): 3.56e-4,
             ('mlp', 'hybrid'): 0.481}}
PUBLISHED_OTHERS = 6.3e-8

Results = Mapping[str, Any]


def compared(results: Results, first: str, second: str, part: str = 'test',
             step: str = 'published') -> float:
    """Compare two methods by the Mann-Whitney test on their one-step errors."""
    runs = _networks(results, step)
    return mann_whitney(*(array(runs[method][part]['one_step']) for method in (first, second)))


def medians(runs: Mapping[str, Any], part: str, mode: str = 'one_step') -> dict[str, float]:
    """Take the medians of all methods."""
    return {method: median(found[part][mode]) for method, found in runs.items()}


def one_step(results: Results) -> str:
    """Set the published figures beside those found, one step."""
    study = results['published']

    def extremes(which: int) -> list[str]:
        return [number(five_numbers(array(study['runs'][m]['test']['one_step']))[which])
                for m in (*METHODS, 'least_squares')]

    rows = []
    for part in PARTS:
        rows.append([f'published, {part}, median',
                     *map(number, PUBLISHED[f'{part}, median']), '', '', ''])
        found = medians(study['runs'], part)
        rows.append([f'here, {part}, median',
                     *(number(found[m]) for m in (*METHODS, 'least_squares')),
                     number(study['unconstrained'][part]), number(study['persistence'][part])])
    rows.append(['here, test, least', *extremes(0), '', ''])
    rows.append(['here, test, largest', *extremes(4), '', ''])
    return table(['', *(TITLES[m] for m in METHODS), 'LS', '14 free', 'last'], rows)


def summaries(results: Results) -> str:
    """Lay out [B19] Tables 4 and 5: five numbers of every method."""
    rows = []
    for part in PARTS:
        for method in METHODS:
            numbers = five_numbers(array(results['published']['runs'][method][part]['one_step']))
            rows.append([part, TITLES[method], *map(number, numbers)])
    return table(['', '', 'min', 'Q1', 'median', 'Q3', 'max'], rows)


def p_values(results: Results, part: str) -> str:
    """Lay out [B19] Table 6 or 7, with the published value in brackets."""
    def cell(first: str, second: str) -> str:
        published = PUBLISHED_P[part].get((first, second), PUBLISHED_OTHERS)
        return f'{p_value(compared(results, first, second, part))} ({p_value(published)})'

    rows = [[TITLES[first], *(cell(first, second) if i < j else ''
                              for j, second in enumerate(METHODS))]
            for i, first in enumerate(METHODS)]
    return table(['', *(TITLES[m] for m in METHODS)], rows[:-1])


def _mean_of(candidate: Mapping[str, Any]) -> float:
    return float(np.mean(candidate['validation']))


def _candidates(rows: Iterable[Mapping[str, Any]], best: Mapping[str, Any],
                name: str) -> Iterable[list[str]]:
    for row in rows:
        errors = np.array(row['validation'])
        p = mann_whitney(errors, np.array(best['validation']))
        label = small(row['decay'], 0) if name == 'decay' else ', '.join(map(str, row['hidden']))
        yield [label, number(_mean_of(row)), number(float(errors.std(ddof=1)), 2),
               'best' if row is best else p_value(p)]


def _round(one: Mapping[str, Any], name: str) -> str:
    best = min(one['candidates'], key=_mean_of)
    return table([name, 'validation, mean', 'std', 'p against the best'],
                 _candidates(one['candidates'], best, name))


def decays(results: Results, kind: str) -> str:
    """Lay out the search of the decay with the structure of the paper."""
    return _round(results['settings'][kind][0], 'decay')


def structures(results: Results, kind: str) -> str:
    """Lay out the search of the structure."""
    return _round(results['settings'][kind][1], 'units')


def _described(settings: Mapping[str, Any]) -> str:
    hidden = settings['hidden']
    layers = f'{len(hidden)} layer{"s" if len(hidden) > 1 else ""} of {hidden[0]}'
    return f'{layers}, decay {small(settings["decay"], 0)}'


def chosen(results: Results) -> str:
    """Set what was chosen beside what the paper chose, with the final errors."""
    rows = []
    for kind, published in (('mlp', '2 layers of 77, decay 5e-4'),
                            ('hybrid', '1 layer of 80, decay 0')):
        for step, settings in (('published', published),
                               ('chosen', _described(results['settings'][kind][-1]['chosen']))):
            runs = _networks(results, step)
            rows.append([TITLES[kind], f'{"paper" if step == "published" else "here"}: {settings}',
                         *(number(median(runs[kind][part]['one_step'])) for part in PARTS)])
    return table(['', 'settings', 'train', 'test'], rows)


def validation(results: Results) -> str:
    """Lay out the decays on contiguous validation data."""
    return _round(results['validation'], 'decay')


def equal(results: Results) -> str:
    """Say whether MLP and hybrid are equal: settings of the paper, the MLP's decay chosen, all."""
    pairs = {'With the settings of the paper': ('published', 'published'),
             "with the paper's structures, and the decay of the MLP chosen on validation data":
                 ('chosen', 'published'),
             'with structure and decay of both chosen so': ('chosen', 'chosen')}
    return '; '.join(_against(results, *steps, name) for name, steps in pairs.items()) + '.'


def _against(results: Results, mlp: str, hybrid: str, name: str) -> str:
    errors = [array(_networks(results, step)[kind]['test']['one_step'])
              for kind, step in (('mlp', mlp), ('hybrid', hybrid))]
    medians = [number(float(np.median(found))) for found in errors]
    return f'{name}: {medians[0]} and {medians[1]} in test, p = {p_value(mann_whitney(*errors))}'


def _networks(results: Results, step: str) -> Mapping[str, Any]:
    """Take the runs of the networks with the settings of the paper or those chosen."""
    found: Mapping[str, Any] = results[step]
    return found['runs'] if step == 'published' else found


def box(results: Results) -> str:
    """Lay out least squares in wider boxes, and with other D_m."""
    found, study = results['box'], results['published']
    rows = [[f'box x {factor}' if factor != '1' else 'the box of Table 1',
             number(one['train']), number(one['test']), ', '.join(one['at_bound'])]
            for factor, one in found['boxes'].items()]
    rows += [[f'the box, D_m = {small(float(D_m), 0)}', number(one['train']), number(one['test']),
              ', '.join(one['at_bound'])]
             for D_m, one in found['displacements'].items() if D_m != '2e-05']
    rows.append(['14 free', *(number(study['unconstrained'][part]) for part in PARTS), ''])
    return table(['least squares', 'train', 'test', 'at the edge'], rows)


def box_share(results: Results) -> str:
    """Say what of the gap between the linear model and 14 free coefficients is the box."""
    boxes, study = results['box']['boxes'], results['published']
    shares = {}
    for factor in ('3', '10'):
        shares[factor] = [100 * (boxes['1'][part] - boxes[factor][part])
                          / (boxes['1'][part] - study['unconstrained'][part]) for part in PARTS]
    D_m = results['box']['displacements']['5e-05']
    return (f'In the box of Table 1, {len(boxes["1"]["at_bound"])} of the 9 parameters stop at '
            f'its edge. Three times as wide a box closes {shares["3"][0]:.0f} % of the gap to 14 '
            f'free coefficients in training and {shares["3"][1]:.0f} % in test, ten times as wide '
            f'{shares["10"][0]:.0f} and {shares["10"][1]:.0f} %. D_m = 5e-5 m^3/rad does much of '
            f'it in the box as it is: {number(D_m["train"])} and {number(D_m["test"])}.')


def alignment(results: Results) -> str:
    """Compare both interpretations of the alignment."""
    study = results['published']
    rows = []
    for name, key in (('LS', 'least_squares'), ('14 free', 'unconstrained'), ('MLP', 'mlp'),
                      ('hybrid', 'hybrid')):
        as_eq1 = ([study['unconstrained'][part] for part in PARTS] if key == 'unconstrained'
                  else [median(study['runs'][key][part]['one_step']) for part in PARTS])
        literal = [median(results['alignment'][key][part]) for part in PARTS]
        rows.append([name, *map(number, as_eq1), *map(number, literal)])
    ratios = []
    for column in range(1, 5):
        ls, networks = float(rows[0][column]), [float(row[column]) for row in rows[2:]]
        ratios.append(number(ls / min(networks), 2))
    rows.append(['LS over the better network', *ratios])
    return table(['', 'eq. 1, train', 'test', 'Sect. 3, train', 'test'], rows)


def choices(found: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """Lay out medians of both parts by choice, the first of each method as it is here."""
    rows, reference = [], ''
    for name, errors in found.items():
        method = name.split(':')[0]
        first = not reference.startswith(method + ':')
        reference = name if first else reference
        p = '' if first else p_value(mann_whitney(np.array(errors['test']),
                                                  np.array(found[reference]['test'])))
        rows.append([name, *(number(median(errors[part])) for part in PARTS), p])
    return table(['choice', 'train', 'test', 'p against the first, test'], rows)


def share_of_range(results: Results) -> str:
    """Express errors as a share of the range, as Sect. 5 of the paper does."""
    def share(value: float) -> str:
        return f'{100 * value / SPAN:.1f} %'
    found = medians(results['published']['runs'], 'test')
    best = min(found[m] for m in OPTIMISERS)
    networks = [median(results['chosen'][kind]['test']['one_step']) for kind in ('mlp', 'hybrid')]
    rows = [['published', share(min(PUBLISHED['test, median'][:4])),
             share(PUBLISHED['test, median'][4]), share(PUBLISHED['test, median'][5]), ''],
            ['here, settings of the paper', share(best), share(found['mlp']),
             share(found['hybrid']), share(results['published']['persistence']['test'])],
            ['here, settings chosen on validation data', share(best), *map(share, networks), '']]
    return table(['test, median over 300 N m', 'linear, best', 'MLP', 'hybrid', 'last'], rows)


def swapped(results: Results) -> str:
    """Lay out the study with both parts swapped."""
    study, direct = results['swapped'], results['published']

    def row(name: str, of: Mapping[str, Any], part: str, last: bool = True) -> list[str]:
        found = medians(of['runs'], part)
        return [name, *(number(found[m]) for m in (*METHODS, 'least_squares')),
                number(of['unconstrained'][part]), number(of['persistence'][part]) if last else '']
    return table(['', *(TITLES[m] for m in METHODS), 'LS', '14 free', 'last'], [
        row('train (without the burst)', study, 'train'),
        row('test (with it)', study, 'test'),
        row('the same part, when it was the training part', direct, 'train', last=False)])


def free_run(results: Results) -> str:
    """Lay out medians of the free run."""
    rows = []
    for name, step, part in (('train', 'published', 'train'), ('test', 'published', 'test'),
                             ('swapped, test', 'swapped', 'test')):
        found = medians(results[step]['runs'], part, 'free_run')
        rows.append([name, *(number(found[m]) for m in (*METHODS, 'least_squares'))])
    rows.append(['test, chosen settings', '', '', '', '', *(
        number(median(results['chosen'][kind]['test']['free_run']))
        for kind in ('mlp', 'hybrid')), ''])
    return table(['median', *(TITLES[m] for m in METHODS), 'LS'], rows)


def drop(results: Results) -> str:
    """Say how all methods meet a burst that they were not trained on."""
    swapped, direct = results['swapped']['runs'], results['published']['runs']
    train, met = (medians(swapped, part) for part in PARTS)
    learned = medians(direct, 'train')

    def worse(method: str, than: Mapping[str, float]) -> str:
        return f'{100 * (met[method] / than[method] - 1):.0f} %'
    return (f'The MLP is {worse("mlp", train)} worse on the burst than in training and '
            f'{worse("mlp", learned)} worse than when it was trained on it, the hybrid '
            f'{worse("hybrid", train)} and {worse("hybrid", learned)}. PSO is '
            f'{worse("pso", train)} worse than in training, but only {worse("pso", learned)} '
            'worse than when it was fitted to it.')


def free_fit(results: Results) -> str:
    """Give the errors of the linear model fitted to its free run."""
    errors = results['physics']['free_run']['errors']
    one_step = results['physics']['one_step']['errors']['free_run']['test']
    return (f'The linear model fitted to the free run has {number(errors["free_run"]["train"])} '
            f'in training and **{number(errors["free_run"]["test"])}** in test, '
            f'{one_step / errors["free_run"]["test"]:.1f} times less than fitted to one step, at '
            f'{number(errors["one_step"]["test"])} one step.')


def runaway(results: Results) -> str:
    """Say how far the networks' free runs leave the measurement at worst."""
    errors = {kind: array(results['swapped']['runs'][kind]['test']['free_run'])
              for kind in ('mlp', 'hybrid')}
    diverged = sum(int(np.isinf(found).sum()) for found in errors.values())
    return (f'Trained on the swapped part, the worst hybrid has a free-run error of '
            f'{number(max(errors["hybrid"]), 3)}, the worst MLP of '
            f'{number(max(errors["mlp"]), 3)}; {diverged or "none"} of 40 diverged.')


def gain(results: Results) -> str:
    """Give K_q K_sv as fitted by one step and by the free run."""
    fitted = {name: found['parameters'] for name, found in results['physics'].items()}
    product = {name: p['K_q'] * p['K_sv'] for name, p in fitted.items()}
    return (f'The one-step fit puts the gain K_q K_sv at {small(product["one_step"], 1)}, the '
            'lowest corner of the box; the rig was simulated with 5.5e-5. The free-run fit finds '
            f'{small(product["free_run"], 1)}.')


def nine(results: Results) -> str:
    """Say where PSO with three seeds puts K_sv, and how good that is."""
    fits = [results['physics'][f'pso {seed}'] for seed in range(3)]
    values = [small(found['parameters']['K_sv'], 2) for found in fits]
    errors = [f'{found["errors"]["one_step"]["train"]:.4f}' for found in fits]
    return (f'`refit --method pso` with seeds 0, 1 and 2 puts K_sv at {", ".join(values)} m/V, '
            f'with one-step errors in training of {", ".join(errors)}.')


def mild(results: Results) -> str:
    """Give the errors on the rigs that lack less."""
    each = (f'`{name}` linear {found["least_squares"]:.3f}, MLP {median(found["mlp"]):.3f}'
            for name, found in results['mild'].items())
    return f'{"; ".join(each)}.'


NAMES = {'persistence': 'last sample', 'unconstrained': '14 free', 'least_squares': 'LS',
         'mlp': 'MLP', 'hybrid': 'hybrid', 'gru': 'GRU'}


def _cell(errors: Mapping[str, Any], mode: str) -> str:
    return number(median(errors[mode])) if mode in errors else ''


def frequencies(results: Results) -> str:
    """Lay out the errors at higher frequencies of u_m."""
    found = results['frequencies']
    rows = [[NAMES[method], *(_cell(found[trained][method][tested], mode)
                              for mode in ('one_step', 'free_run')
                              for trained in ('paper', 'all') for tested in ('paper', 'higher'))]
            for method in found['paper']]
    return table(['trained on / tested on', 'low / low', 'low / high', 'all / low', 'all / high',
                  'free run: low / low', 'low / high', 'all / low', 'all / high'], rows)


def measured(results: Results) -> str:
    """Lay out the errors on the measured leg."""
    found = results['measured']
    return table(['trained on the 1 Hz record', '1 Hz', 'sweep', 'free run: 1 Hz', 'sweep'],
                 [[NAMES[method], *(_cell(errors[tested], mode)
                                    for mode in ('one_step', 'free_run')
                                    for tested in ('1 Hz', 'sweep'))]
                  for method, errors in found.items()])
